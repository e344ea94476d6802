"""Scenes: frames, views, lights and shadow maps of a capture with its surface."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from hyjax import (
    AmbientLight,
    InputError,
    LightSetup,
    PointLight,
    Relighter,
    RelightSettings,
    Scene,
    SceneSettings,
    View,
    relight_capture,
)
from hyjax import configuration as configuration_module
from hyjax.choices.options import LightOptions
from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.light.kinds import Light, pytree
from hyjax.scene import scene as scene_module

UP = np.array([0.0, 0.0, 1.0])
LENS = Intrinsics(16, 12, 10.0, 10.0, 8.0, 6.0)
LAMP = PointLight(np.array([0.5, 0.0, 0.2]), 900.0, np.ones(3))


class Box(Capture):
    """Two pictures in a box of 4 m."""

    name = "box"
    fingerprint = "box"

    def __init__(self, up: Any = UP, count: int = 2) -> None:
        self.up, self._count = up, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        image = np.full((*LENS.shape, 3), 0.5, np.float32)
        camera = Camera(LENS, look_at(np.array([1.0, 0.2 * index, 0.1]), np.zeros(3), UP))
        return Frame(f"f{index}", image, camera, float(index))


def box() -> trimesh.Trimesh:
    mesh = trimesh.creation.box((4, 4, 3))
    mesh.invert()
    return mesh


@pytest.fixture
def casts(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Lights that shadow maps are cast for."""
    found: list[Any] = []

    def counted(caster: Any, lights: Any, *_: Any, **__: Any) -> Any:
        found.append(lights)
        return (None,) * len(lights)

    monkeypatch.setattr(scene_module, "cast_shadow_maps", counted)
    return found


def test_a_view_has_the_picture_and_the_camera_of_its_frame() -> None:
    scene = Scene(Box(), box(), size=(6, 8))
    view, frame = scene.view(1), scene.frame(1)
    assert isinstance(view, View) and view.frame.shape == (6, 8, 3) and bool(view.gbuffer.hit.all())
    np.testing.assert_array_equal(view.display, frame.image)
    np.testing.assert_allclose(view.pose, frame.camera.pose, rtol=1e-6)
    np.testing.assert_allclose(view.intrinsics, frame.camera.intrinsics.matrix, rtol=1e-6)


def test_shadow_maps_are_cast_once_for_lights_that_stay(casts: list[Any]) -> None:
    scene = Scene(Box(), box())
    for index in range(2):
        scene.shade(scene.view(index), "two-colors")  # by name: a new set-up each time, of the same lights
    assert len(casts) == 1
    scene.shade(scene.view(0), [PointLight(jnp.zeros(3), jnp.asarray(9.0), jnp.ones(3))])
    assert len(casts) == 2
    scene.shade(scene.view(0), "two-colors", shadows=False)
    assert len(casts) == 2


def test_what_throws_shadows_is_asked_for_once_and_an_exact_mesh_does_it_itself() -> None:
    asked: list[int] = []

    def detail() -> None:
        asked.append(1)

    lights = [PointLight(jnp.zeros(3), jnp.asarray(9.0), jnp.ones(3))]
    scene = Scene(Box(), box(), detail=detail)
    (bare,) = scene.shadow_maps(lights, occluders="surface")
    assert bare is not None and bare.slack is None and not asked
    for _ in range(2):
        (completed,) = scene.shadow_maps(lights)
        assert completed is not None and completed.slack is not None
    assert scene.occluders is not scene.caster and len(asked) == 1
    exact = Scene(Box(), box(), detail=detail, slack=None)
    assert exact.occluders is exact.caster and exact.slack is None and len(asked) == 1


def test_lights_by_name_file_set_up_or_one_by_one(tmp_path: Path) -> None:
    scene = Scene(Box(), box())
    file = tmp_path / "lights.yaml"
    file.write_text("lights: [{kind: ambient, illuminance: 80}]\nreference_lux: 50\n")
    assert scene.lights(file).reference_lux == scene.lights(str(file)).reference_lux == 50
    lights = (AmbientLight(jnp.asarray(80.0), jnp.ones(3)),)
    assert scene.lights(lights).lights == lights
    setup = LightSetup(lights, 50.0)
    assert scene.lights(setup) is setup
    with pytest.raises(InputError, match=r"^lights: no set-up 'evening'"):
        scene.lights("evening")


def test_a_capture_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(InputError, match=r"^box: the capture has no frames$"):
        Scene(Box(count=0), box())
    for up in (np.zeros(3), np.array([0.0, 1.0]), np.array([0.0, 0.0, 2.0])):
        with pytest.raises(InputError, match=r"^box: 'up' must be a unit vector of three numbers"):
            Scene(Box(up), box())
    for slack in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"^slack: must be metres, 0 or more, or None for an exact mesh"):
            Scene(Box(), box(), slack=slack)
    with pytest.raises(InputError, match=r"^frame 2: the capture has frames 0 to 1$"):
        Scene(Box(), box()).view(2)


def test_frames_are_checked_before_the_mesh_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SceneSettings, "open_capture", lambda *_, **__: Box())

    def made(*_: Any, **__: Any) -> None:
        raise AssertionError("the mesh was made")

    monkeypatch.setattr(scene_module, "surface_arrays", made)
    settings = RelightSettings(SceneSettings(tmp_path), frames="7", out=tmp_path / "out", quiet=True)
    with pytest.raises(InputError, match="past the end; the capture has frames 0 to 1"):
        relight_capture(settings)


@pytree
class Unregistered(Light):
    """A kind of light that nothing knows."""

    KEYS = ()
    STRENGTH = "illuminance"
    illuminance: Any
    color: Any

    def illuminance_at(self, p: Any, n: Any) -> Any:
        return jnp.broadcast_to(self.illuminance, p.shape[:-1])


def test_an_unregistered_light_is_refused_before_the_first_frame(tmp_path: Path) -> None:
    lights = [Unregistered(jnp.asarray(50.0), jnp.ones(3))]
    settings = RelightSettings(out=tmp_path, quiet=True)
    with pytest.raises(InputError, match="Unregistered is no registered kind of light"):
        relight_capture(settings, scene=Scene(Box(), box()), lights=lights, schedule=Schedule.uniform([(2, 1)]))
    assert not list(tmp_path.iterdir())


def test_the_record_says_what_was_given(tmp_path: Path) -> None:
    settings = RelightSettings(out=tmp_path, quiet=True, shadows=False, frames="0")
    lights = [AmbientLight(jnp.asarray(50.0), jnp.ones(3))]
    scene = Scene(Box(), box(), source="a box")
    record = relight_capture(settings, scene=scene, lights=lights, schedule=Schedule.uniform([(2, 1)]))["settings"]
    assert record["capture"] == "box" and record["mesh"] == "a box" and record["lights"] == "lights.json"
    assert record["seed"] is None and record["guide"] == "rgb" and record["schedule"] == "custom"


def test_the_record_says_which_lights_were_named(tmp_path: Path) -> None:
    file = tmp_path / "lamps.yaml"
    file.write_text("lights: [{kind: ambient, illuminance: 80}]\n")
    for lights in (file, str(file)):
        settings = RelightSettings(out=tmp_path / "out", quiet=True, shadows=False, frames="0")
        run = relight_capture(settings, scene=Scene(Box(), box()), lights=lights)
        assert run["settings"]["lights"] == str(file)


def test_what_is_kept_of_the_photo_needs_its_light_divided_out(tmp_path: Path) -> None:
    scene = Scene(Box(), box())
    setup = LightSetup((PointLight(jnp.zeros(3), jnp.asarray(9.0), jnp.ones(3)),), existing={"walls": (1.0,) * 3})
    refused = r"^lights: 'existing' keeps some of the photo's own light; leave keep_photo_light"
    with pytest.raises(InputError, match=refused):
        scene.shade(scene.view(0), setup, keep_photo_light=True)
    for settings in (
        RelightSettings(out=tmp_path, keep_photo_light=True),
        RelightSettings(out=tmp_path, paper_mode=True),
    ):
        with pytest.raises(InputError, match=refused):
            relight_capture(settings, scene=scene, lights=setup)
    with pytest.raises(InputError, match=r"no source 'wals' \(did you mean 'walls'"):
        scene.photo_light.kept({"wals": (1.0,) * 3})


def test_a_scene_that_tells_nothing_of_its_light_is_taken_to_be_evenly_lit() -> None:
    """Grey pictures of an empty box: even light, told in the log."""
    scene = Scene(Box(), box())
    light = [PointLight(jnp.zeros(3), jnp.asarray(9.0), jnp.ones(3))]
    divided, kept = (scene.shade(scene.view(0), light, keep_photo_light=keep) for keep in (False, True))
    np.testing.assert_allclose(divided.photo_light, 1.0, rtol=1e-4)
    np.testing.assert_array_equal(divided.illuminance, kept.illuminance)


def test_named_lights_come_from_the_windows_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "windows.yaml"
    file.write_text("windows: [{center: [0, 2, 0], normal: [0, -1, 0], width: 1, height: 1}]")
    scene = Scene(Box(), box(), photo_sources=file)
    for at_sources in (True, False):
        sky = scene.lights("night-moon", at_photo_sources=at_sources).lights[0]
        assert np.allclose(sky.center, [0, 1.99, 0], atol=1e-5) == at_sources


@pytest.mark.usefixtures("casts")
def test_large_frames_are_relit_at_a_smaller_size(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(Box(), box())
    kept = Configuration().with_choices({"photo_light": "kept", "sampling": 1})
    halved = Relighter(scene, LAMP, kept.with_choices({"scale": 2})).relit(0)
    monkeypatch.setattr(configuration_module, "USUAL_PIXELS", LENS.width * LENS.height // 4)
    relighter = Relighter(scene, LAMP, kept)
    assert relighter.view(0).frame.shape == (6, 8, 3)
    np.testing.assert_array_equal(relighter.relit(0).image, halved.image)
    others = ({"video": True}, {"whole": True})
    for whole in (*(Relighter(scene, LAMP, kept, **other) for other in others), Relighter(scene, LAMP, "paper")):
        assert whole.view(0).frame.shape == whole.relit(0).image.shape == (12, 16, 3)
    sampled = Relighter(scene, LAMP, Configuration(light=LightOptions(photo_light="kept")))
    assert sampled.view(0).frame.shape == (3, 4, 3) and sampled.relit(0).image.shape == (12, 16, 3)
