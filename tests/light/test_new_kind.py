"""A kind of light from outside the package: read, shaded, shadowed, relit, written and read back."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from hyjax import GBuffer, InputError, Light, LightSetup, PointLight, Schedule, View, relight, shade, visibilities
from hyjax.data.light_file import parse_lights, read_lights, write_lights
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.kinds import LIGHT_KINDS, kind_name, pytree, register_light
from hyjax.light.kinds.file_keys import LUMINOUS_FLUX, FileKey
from hyjax.light.kinds.shadow_views import SPHERE, RadialViews

UP = np.array([0.0, 0.0, 1.0])
TUBE = {"kind": "tube", "start": [-0.5, 0, 2], "end": [0.5, 0, 2], "luminous_flux": 1200, "twist_degrees": 30}


@pytree
class TubeLight(Light):
    """A fluorescent tube, as points on a line."""

    KEYS = (
        FileKey("start", "vector"),
        FileKey("end", "vector"),
        LUMINOUS_FLUX,
        FileKey("twist_degrees", default=0.0, most=180.0, field="twist", degrees=True),
    )
    start: jax.Array
    end: jax.Array
    luminous_flux: jax.Array
    color: jax.Array
    twist: jax.Array

    def _points(self) -> jax.Array:
        return self.start + jnp.linspace(0.0, 1.0, 4)[:, None] * (self.end - self.start)

    def illuminance_at(self, p: jax.Array, n: jax.Array) -> jax.Array:
        share = self.luminous_flux / 4
        return sum(PointLight(point, share, self.color).illuminance_at(p, n) for point in self._points())

    def shadow_views(self) -> RadialViews:
        return RadialViews(np.asarray(self._points(), np.float64), np.eye(3), "octahedral", SPHERE)


@pytest.fixture
def tube() -> Iterator[None]:
    register_light("tube", TubeLight)
    yield
    del LIGHT_KINDS["tube"]


def floor(size: int = 24) -> GBuffer:
    """Points on the floor z = 0, two metres wide."""
    x, y = np.meshgrid(*[np.linspace(-1, 1, size)] * 2)
    position = jnp.asarray(np.stack([x, y, 0 * x], axis=-1), jnp.float32)
    normal = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), position.shape)
    return GBuffer(position, normal, jnp.ones((size, size)), jnp.ones((size, size), bool))


@pytest.mark.usefixtures("tube")
def test_a_new_kind_goes_all_the_way(tmp_path: Path) -> None:
    (tmp_path / "lights.yaml").write_text(f"lights: [{TUBE}]")
    setup = read_lights(tmp_path / "lights.yaml", UP)
    (light,) = setup.lights
    assert isinstance(light, TubeLight) and float(light.luminous_flux) == 1200
    assert float(light.twist) == pytest.approx(np.pi / 6)

    board = trimesh.creation.box(bounds=[[-0.3, -0.3, 0.5], [0.3, 0.3, 0.55]])
    ground = trimesh.creation.box(bounds=[[-2, -2, -0.1], [2, 2, 0]])
    gbuffer, maps = floor(), cast_shadow_maps(RayCaster(ground + board), setup.lights, 0.1)
    lux = np.asarray(shade(gbuffer, setup.lights))
    lit = np.asarray(visibilities(gbuffer, setup.lights, maps))[..., 0]
    assert lux.shape == (24, 24, 3) and (lux > 0).all()
    assert lit[12, 12] == 0 and lit[0, 0] == 1
    assert ((lit > 0.1) & (lit < 0.9)).any(), "the tube is seen in part: a penumbra"

    frame = jnp.full((24, 24, 3), 0.5)
    view = View.of(frame, gbuffer)
    shaded = view.shade(setup, shadow_maps=maps)
    sharp = Schedule.preset("hyjax-shadow")
    relit = relight(view, shaded, frame, Schedule.uniform([(2, 4)]), shadow_schedule=sharp)
    assert np.isfinite(relit.image).all() and relit.image[12, 12, 0] < 0.2 * relit.image[0, 0, 0]

    write_lights(tmp_path / "written.json", setup)
    (again,) = read_lights(tmp_path / "written.json", UP).lights
    assert type(again) is TubeLight
    for field in dataclasses.fields(TubeLight):
        np.testing.assert_allclose(getattr(again, field.name), getattr(light, field.name), rtol=1e-6)


@pytest.mark.usefixtures("tube")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strat": [0, 0, 0]}, r"light 0 \(tube\): unknown key 'strat' \(did you mean 'start'\?\)"),
        ({"end": [0, 0]}, "'end' must be three finite numbers"),
        ({"twist_degrees": 200}, "'twist_degrees' must be a finite number >= 0 and <= 180, got 200"),
    ],
)
def test_its_keys_are_checked_as_those_of_other_kinds(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_lights({"lights": [TUBE | changes]}, UP)


@pytest.mark.usefixtures("tube")
def test_blender_says_that_it_cannot_render_it() -> None:
    (light,) = parse_lights({"lights": [TUBE]}, UP).lights
    with pytest.raises(InputError, match=r"^blender: cannot render a TubeLight"):
        light.emitter()
    assert PointLight(np.zeros(3), 1.0, np.ones(3)).emitter() is not None


def test_a_kind_that_is_not_registered_is_neither_read_nor_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="light 0: unknown kind 'tube'; there are ambient, directional, point"):
        parse_lights({"lights": [TUBE]}, UP)
    light = TubeLight(np.zeros(3), np.ones(3), np.ones(()), np.ones(3), np.zeros(()))
    with pytest.raises(InputError, match=r"^lights: TubeLight is no registered kind of light") as caught:
        write_lights(tmp_path / "lights.json", LightSetup((light,)))
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


@pytest.mark.usefixtures("tube")
def test_names_are_taken_once() -> None:
    register_light("tube", TubeLight)  # again, as when a module is imported twice
    with pytest.raises(InputError, match="kind 'point' is PointLight; choose another name"):
        register_light("point", TubeLight)
    assert kind_name(PointLight(np.zeros(3), 1.0, np.ones(3))) == "point"
