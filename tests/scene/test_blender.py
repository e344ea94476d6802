"""Cycles against our own shading, shadows and cameras; skipped where there is no Blender.

Shading is compared where a light throws at least 2 % of its strongest; below that a relative error says little.
"""

import dataclasses
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from extras import needs_blender

from hyjax import (
    AmbientLight,
    Aperture,
    DirectionalLight,
    GBuffer,
    InputError,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
    shade_each,
    visibilities,
)
from hyjax.cli import main
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import load_room
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.blender import BlenderRenderer, Rendering, blender_python
from hyjax.scene.light_places import survey_capture
from hyjax.scene.light_setups import named_setup
from hyjax.scene.scene import Scene
from hyjax.util.images import read_image

WHITE = jnp.ones(3)


def vec(*values: float) -> jnp.ndarray:
    return jnp.array(values, jnp.float32)


POINT = PointLight(vec(0.9, -0.6, 1.6), jnp.float32(800), WHITE)
SUN = DirectionalLight(vec(0.4, 0.3, -1.0), jnp.float32(500), WHITE)
LIGHTS: dict[str, Light] = {
    "point": POINT,
    "spot": SpotLight(
        vec(-0.8, -0.9, 2.0), vec(0.5, 0.6, -1.6), jnp.float32(900), WHITE, jnp.float32(0.3), jnp.float32(0.6)
    ),
    "sun": SUN,
    "rect": RectLight(vec(-1.2, 0.4, 1.0), vec(0, 0.5, 0), vec(0, 0, 0.4), jnp.float32(2000), WHITE),
    "sky": SkyLight(vec(0.1, 0.2, 1.0), jnp.float32(300), WHITE),
    "ambient": AmbientLight(jnp.float32(40), WHITE),
    "bulb": dataclasses.replace(POINT, radius=0.1),
    "bare": dataclasses.replace(POINT, position=vec(0.0, 0.0, 0.5), clearance=0.6),
    "window": dataclasses.replace(
        SUN, direction=vec(1.0, 0.2, -1.0), aperture=Aperture(vec(-1.2, 0, 1.2), vec(0, 0.4, 0), vec(0, 0, 0.3))
    ),
}
EXACT, NOISY = (1e-4, 5e-3), (0.02, 0.2)  # largest median and 99th percentile of the relative error


@dataclasses.dataclass(frozen=True)
class Compared:
    gbuffer: GBuffer
    shading: np.ndarray
    visibility: np.ndarray
    rendering: Rendering


def compare(mesh: trimesh.Trimesh, camera: Camera, lights: list[Light]) -> Compared:
    caster = RayCaster(mesh)
    gbuffer = caster.gbuffer(camera)
    seen = visibilities(gbuffer, lights, cast_shadow_maps(caster, lights))
    with BlenderRenderer(mesh, lights) as blender:
        rendering = blender.render(camera)
    return Compared(gbuffer, np.asarray(shade_each(gbuffer, lights)), np.asarray(seen), rendering)


def relative_errors(compared: Compared, k: int) -> np.ndarray:
    ours, theirs = compared.shading[..., k], compared.rendering.shading[..., k]
    counts = (ours > 0.02 * ours.max()) & compared.rendering.hit
    assert counts.mean() > 0.1
    return np.abs(theirs / np.where(counts, ours, 1.0) - 1.0)[counts]


def disagreement(compared: Compared, k: int) -> float:
    """Share of lit pixels whose visibility differs by over a tenth."""
    counts = compared.shading[..., k] > 0.02 * compared.shading[..., k].max()
    difference = np.abs(compared.visibility[..., k] - compared.rendering.visibility[..., k])
    return float(np.mean(difference[counts] > 0.1))


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    floor = trimesh.creation.box(extents=(6, 6, 0.02)).apply_translation((0, 0, -0.01))
    floor.unmerge_vertices()
    return trimesh.util.concatenate(
        [floor, trimesh.creation.icosphere(subdivisions=4, radius=0.5).apply_translation((0, 0, 0.5))]
    )


@pytest.fixture(scope="module")
def camera() -> Camera:
    """Oblong pixels, and a lens whose centre is not the picture's."""
    return Camera(Intrinsics(96, 72, 90.0, 99.0, 42.8, 40.1), look_at((1.6, -2.2, 1.7), (0.0, 0.0, 0.3), (0, 0, 1)))


@pytest.fixture(scope="module")
def scene(ball: trimesh.Trimesh, camera: Camera) -> Compared:
    return compare(ball, camera, list(LIGHTS.values()))


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("name", LIGHTS)
def test_unshadowed_light_is_ours(scene: Compared, name: str) -> None:
    """Without an extent to within float32 and the vertex normals; with one, to the noise of 32 rays."""
    median, tail = NOISY if name in ("rect", "sky") else EXACT
    errors = relative_errors(scene, list(LIGHTS).index(name))
    assert np.median(errors) < median
    assert np.percentile(errors, 99) < tail


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("name", LIGHTS)
def test_shadows_are_ours(scene: Compared, name: str) -> None:
    """But for the edges, where our maps are as coarse as their texels, and the few views of our extended lights."""
    k = list(LIGHTS).index(name)
    assert disagreement(scene, k) < (0.15 if name == "rect" else 0.03)
    shadow = scene.rendering.visibility[..., k]
    assert shadow.min() >= 0 and shadow.max() <= 1
    if name not in ("ambient", "bare", "sky"):
        assert shadow.min() < 0.01  # there is one
    if name == "bare":  # the lamp is inside the ball, which is nearer than its clearance
        assert shadow.mean() > 0.95


@needs_blender
@pytest.mark.slow
def test_the_camera_is_ours(scene: Compared) -> None:
    """Silhouettes to the pixel, depth to 0.1 mm: a tenth of a pixel would be 3 mm on this floor."""
    hit = np.asarray(scene.gbuffer.hit)
    assert 0.1 < np.mean(~hit) < 0.9
    assert np.mean(hit != scene.rendering.hit) < 1e-3
    both = hit & scene.rendering.hit
    off = np.abs(scene.rendering.depth - np.asarray(scene.gbuffer.depth))[both]
    assert np.percentile(off, 99) < 1e-4
    assert np.all(scene.rendering.shading[~scene.rendering.hit] == 0)
    assert np.all(scene.rendering.visibility[~scene.rendering.hit] == 1)


@needs_blender
@pytest.mark.slow
def test_the_room_is_ours() -> None:
    """Its true mesh under two points, and with smoothed normals: those of a vertex, not of a triangle."""
    room = load_room(progress=False)
    lights = list(named_setup("two-colors", survey_capture(RayCaster(room.reference()), room)).lights)
    view = room[15].camera
    compared = compare(room.reference(), Camera(view.intrinsics.resize(72, 96), view.pose), lights)
    assert np.mean(np.asarray(compared.gbuffer.hit) != compared.rendering.hit) < 1e-3
    for k in range(len(lights)):
        errors = relative_errors(compared, k)
        assert np.median(errors) < 1e-4
        assert np.percentile(errors, 99) < 0.01
        assert disagreement(compared, k) < 0.06  # thin things: leaves, chair legs


@needs_blender
@pytest.mark.slow
def test_a_relit_capture_looks_the_same(tmp_path: Path) -> None:
    room = load_room(progress=False)
    scene = Scene(room, room.reference(), size=(48, 64))
    pictures = {}
    for renderer in ("shadow_map", "blender"):
        settings = RelightSettings(
            frames="15",
            lights="two-colors",
            renderer=renderer,
            keep_photo_light=True,
            exr=True,
            out=tmp_path / renderer,
            quiet=True,
        )
        run = relight_capture(settings, scene=scene, schedule=Schedule.uniform([(2, 2)]))
        assert run["renderer"] == renderer
        assert (
            ("blender" in run["milliseconds"]) == (renderer == "blender") != ("shadow maps" in run["milliseconds"])
        )
        pictures[renderer] = read_image(tmp_path / renderer / "015.relit.exr")
    ours, theirs = pictures.values()
    assert 0 < np.mean(np.abs(theirs - ours)) < 0.03 * np.mean(ours)


# ---- bad input ----


def test_without_blender_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HYJAX_BLENDER", raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install bpy.*HYJAX_BLENDER") as error:
        blender_python()
    assert "\n" not in str(error.value)


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A program in the place of Blender's python."""
    path = tmp_path / "python"
    monkeypatch.setenv("HYJAX_BLENDER", str(path))
    return path


def test_a_program_that_is_not_there(program: Path) -> None:
    with pytest.raises(InputError, match=r"HYJAX_BLENDER: .* is not a program"):
        blender_python()


def test_a_python_without_bpy(program: Path, ball: trimesh.Trimesh) -> None:
    program.write_text(
        "#!/bin/sh\necho starting; echo \"ModuleNotFoundError: No module named 'bpy'\" >&2; exit 1\n"
    )
    program.chmod(0o755)
    with pytest.raises(InputError, match=r"blender: ended with status 1 \(ModuleNotFoundError: .*'bpy'\)"):
        BlenderRenderer(ball, [POINT])


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands in for Blender")
def test_a_crash_is_one_line(program: Path, ball: trimesh.Trimesh, camera: Camera) -> None:
    program.write_text(
        '#!/bin/sh\necho "Blender 5"; echo "@hyjax ready"; read line; echo "out of memory" >&2; kill -9 $$\n'
    )
    program.chmod(0o755)
    with (
        BlenderRenderer(ball, [POINT]) as blender,
        pytest.raises(InputError, match=r"blender: ended with status -9 \(out of memory\)"),
    ):
        blender.render(camera)


def test_relighting_without_blender_writes_nothing(
    program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["hyjax", "relight", "--renderer", "blender", "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and "HYJAX_BLENDER" in capsys.readouterr().err
    assert not out.exists()


def test_no_lights_and_no_samples(ball: trimesh.Trimesh) -> None:
    with pytest.raises(InputError, match="no lights"):
        BlenderRenderer(ball, [])
    with pytest.raises(InputError, match="samples must be at least 1"):
        BlenderRenderer(ball, [POINT], samples=0)
