"""A capture relit from Python: which frames, at which size, what is written, what is skipped."""

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from common import UNOPTIMISED
from hypothesis import given
from hypothesis import strategies as st

from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit, select_frames, spread
from hyjax.data.light_file import parse_lights, read_lights, write_lights
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import WHITE, to_display
from hyjax.light.setup import LightSetup
from hyjax.metrics.dark_share import dark_share
from hyjax.relighting.ahead import EvenlyLitPlace
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.images import read_image

UP = np.array([0.0, 0.0, 1.0])
SCHEDULE = Schedule.uniform([(2, 2)])
ALL = list(range(24))


@pytest.mark.parametrize(
    "text, chosen",
    [
        ("all", ALL),
        (" all ", ALL),
        ("7", [7]),
        ("-1", [23]),
        ("-24", [0]),
        ("0:24:10", [0, 10, 20]),
        ("0:24", ALL),
        (":3", [0, 1, 2]),
        ("22:", [22, 23]),
        ("-2:", [22, 23]),
        (":", ALL),
        ("::12", [0, 12]),
        ("::-12", [23, 11]),
        ("0,5,9:12", [0, 5, 9, 10, 11]),
        ("0, 5 , 9 : 12", [0, 5, 9, 10, 11]),
        ("23,0", [23, 0]),
    ],
)
def test_select_frames(text: str, chosen: list[int]) -> None:
    assert select_frames(text, 24) == chosen


@pytest.mark.parametrize("text", ["24", "-25", "0:25", "24:", "0:300:30", "0,24", "3:-25", "-25:"])
def test_frames_past_the_end_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="past the end; the capture has frames 0 to 23"):
        select_frames(text, 24)


@pytest.mark.parametrize(
    "text", ["", " ", ",", "0,", "a", "1.5", "0:1:2:3", "0:5:0", "0-5", "all:3", "1 2", "0x1", "²"]
)
def test_frames_of_another_form_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not of the form"):
        select_frames(text, 24)
    with pytest.raises(InputError, match="is not of the form"):
        RelightSettings(frames=text).check()  # before a capture is opened, or the built-in room rendered


@pytest.mark.parametrize("text", ["3:3", "5:2", "2:5:-1"])
def test_selecting_nothing_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="selects no frame"):
        select_frames(text, 24)


def test_no_frame_comes_twice() -> None:
    """It would be computed and counted twice and written to one file."""
    assert select_frames("0,0:2,0", 24) == [0, 1]


@given(size=st.integers(1, 400), count=st.integers(1, 12))
def test_spread(size: int, count: int) -> None:
    got = spread(range(size), count)
    assert len(got) == min(size, count) and got[0] == 0 and (count == 1 or got[-1] == size - 1)
    gaps = np.diff(got)
    assert np.all(gaps > 0) and (len(gaps) == 0 or gaps.max() - gaps.min() <= 1)


def test_nothing_to_spread() -> None:
    assert spread([], 4) == []


# Spots on a plane at 2 m, seen by a lens whose centre is not the picture's.
LENS = Intrinsics(240, 160, 200.0, 210.0, 113.0, 86.0)
SPOTS = np.array([[0.0, 0.0, 2.0], [0.3, -0.2, 2.0], [-0.35, 0.25, 2.0], [0.25, 0.3, 2.0]])


def spot_frame() -> Frame:
    camera = Camera(LENS, np.eye(4))
    y, x = np.mgrid[0:160, 0:240] + 0.5
    (xy, _), image = camera.project(SPOTS), np.zeros((160, 240, 3))
    for px, py in xy:
        image += np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 3.0**2))[..., None]
    return Frame("spots", image.clip(0, 1).astype(np.float32), camera, 0.0, np.full((160, 240), 2.0, np.float32))


SIZES = [(80, 120), (320, 480), (100, 100), (64, 200), (150, 90), (53, 71), (161, 239)]


@pytest.mark.parametrize("size", SIZES)
def test_fit_keeps_picture_and_intrinsics_aligned(size: tuple[int, int]) -> None:
    """A known point is found in the picture where the new intrinsics project it, far better than half a pixel."""
    frame = fit(spot_frame(), size)
    assert frame.image.shape == (*size, 3) and frame.camera.intrinsics.shape == size
    assert frame.image.dtype == np.float32 and frame.depth is None
    xy, _ = frame.camera.project(SPOTS)
    radius = 6.0 * size[0] / 160 * max(1.0, 160 / size[0] * 0.6)
    found = 0
    y, x = np.mgrid[0 : size[0], 0 : size[1]] + 0.5
    linear = np.asarray(frame.image[..., 0], float) ** 2.2
    for px, py in xy:
        if not (radius < px < size[1] - radius and radius < py < size[0] - radius):
            continue
        weight = np.where(np.hypot(x - px, y - py) < radius, linear, 0.0)
        assert abs((weight * x).sum() / weight.sum() - px) < 0.06
        assert abs((weight * y).sum() / weight.sum() - py) < 0.06
        found += 1
    assert found >= 2


def test_no_size_and_no_frames_are_errors() -> None:
    for size in ((0, 0), (-4, 8)):
        with pytest.raises(InputError, match="size: must be at least 1x1"):
            fit(spot_frame(), size)
    for count in (0, -1):
        with pytest.raises(InputError, match="frames: must be at least 1"):
            spread([1, 2, 3], count)


@pytest.mark.parametrize("size", [*SIZES, (160, 240), None])
def test_fit_takes_the_largest_centred_window(size: tuple[int, int] | None) -> None:
    frame = fit(spot_frame(), size)
    height, width = size or (160, 240)
    k, scale = frame.camera.intrinsics, max(height / 160, width / 240)
    # The same angle per pixel along both axes as before, but for the window's rounding to whole pixels.
    assert k.fx == pytest.approx(LENS.fx * scale, rel=0.01) and k.fy == pytest.approx(LENS.fy * scale, rel=0.01)
    assert k.cx / scale - 113 == pytest.approx(width / scale / 2 - 120, abs=1)
    assert k.cy / scale - 86 == pytest.approx(height / scale / 2 - 80, abs=1)
    assert frame.depth is None and frame.depth_intrinsics is None


def test_fit_averages_light_and_not_display_values() -> None:
    image = np.zeros((160, 240, 3), np.float32)
    image[:, ::2] = 1.0
    small = fit(Frame("stripes", image, Camera(LENS, np.eye(4)), 0.0), (80, 120)).image[10:-10, 10:-10]
    np.testing.assert_allclose(small.mean(), to_display(jnp.float32(WHITE / 2)), atol=0.01)
    assert small.min() >= 0 and small.max() <= 1


def test_fit_stays_in_range_at_hard_edges() -> None:
    image = np.zeros((160, 240, 3), np.float32)
    image[40:120, 60:180] = 1.0
    for size in SIZES:
        fitted = fit(Frame("box", image, Camera(LENS, np.eye(4)), 0.0), size).image
        assert np.isfinite(fitted).all() and fitted.min() >= 0 and fitted.max() <= 1


def test_a_narrow_window_beside_the_principal_point_is_possible() -> None:
    """The middle 10 columns do not hold cx = 113; the picture is none the worse for it."""
    frame = fit(spot_frame(), (160, 10))
    assert frame.image.shape == (160, 10, 3)


class Corner(Capture):
    """Three frames of a room's corner; the middle one looks away from the mesh."""

    name = "corner"
    up = UP
    fingerprint = "corner"

    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: int) -> Frame:
        number = range(3)[index]
        target = np.array([2.0, 0.2 * number, -0.3]) * (-1.0 if number == 1 else 1.0)
        camera = Camera(Intrinsics(48, 32, 40.0, 40.0, 24.0, 16.0), look_at(np.zeros(3), target, UP))
        image = np.random.default_rng(number).uniform(0.2, 0.8, (32, 48, 3)).astype(np.float32)
        return Frame(f"f{number}", image, camera, float(number))

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(3))


class Twice(Corner):
    """Each of them once more."""

    def __len__(self) -> int:
        return 6

    def __getitem__(self, index: int) -> Frame:
        frame = super().__getitem__(index % 3)
        return frame if index < 3 else dataclasses.replace(frame, name=frame.name.replace("f", "g"))


def make_wall() -> RayCaster:
    corners = [[2, -5, -5], [2, 5, -5], [2, 5, 5], [2, -5, 5.0]]
    return RayCaster(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False))


@pytest.fixture(scope="module")
def wall() -> RayCaster:
    return make_wall()


@pytest.fixture(scope="module")
def setup() -> LightSetup:
    return make_setup()


def make_setup() -> LightSetup:
    lights = [
        {"kind": "point", "position": [0.5, 0.5, 0.5], "luminous_flux": 3000},
        {"kind": "ambient", "illuminance": 50, "color": [0.5, 0.7, 1.0]},
    ]
    return parse_lights({"reference_lux": 250, "lights": lights}, UP)


def relight(wall: RayCaster, setup: LightSetup, out: Path, **options: Any) -> dict:
    capture, size = options.pop("capture", None) or Corner(), options.pop("size", None)
    scene = Scene(capture, wall.mesh, size=size, source="für immer")
    settings = RelightSettings(out=out, quiet=True, **options)
    return relight_capture(settings, scene=scene, lights=setup, schedule=SCHEDULE)


@pytest.fixture(scope="module")
def run(wall: RayCaster, setup: LightSetup, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    out = tmp_path_factory.mktemp("run") / "made" / "here"
    jax.clear_caches()  # the first frame is to compile, whatever ran before
    return relight(wall, setup, out, save_filters=True, save_visibility=True, exr=True), out


@pytest.mark.slow
def test_run_is_summarised(run: tuple[dict, Path], setup: LightSetup) -> None:
    summary, out = run
    assert json.loads((out / "run.json").read_text(encoding="utf-8")) == summary
    assert summary["frames"] == ["f0", "f2"]
    assert summary["frames_without_surface"] == ["f1"]
    assert summary["size"] == [32, 48] and summary["mode"] == "linear" and summary["mesh_faces"] == 2
    assert summary["reference_lux"] == 250
    recorded = summary["settings"]
    assert recorded["mesh"] == "für immer" and recorded["save_filters"] is True and recorded["out"] == str(out)
    assert SceneSettings().options().keys() <= recorded.keys()
    assert Schedule.from_json(json.dumps(summary["schedule"])).to_json() == SCHEDULE.to_json()
    assert summary["peak_memory_mib"] > 50
    stages = summary["milliseconds"]
    assert {"read", "g-buffer", "shading", "visibility", "cascade", "shadow pass", "composite", "write"} <= set(
        stages
    )
    assert {stages[stage]["count"] for stage in ("shading", "cascade", "composite", "write")} == {1}
    ahead = "programs" in stages  # where the photo's light was not kept: maps are cast before, and looked up again
    assert stages["read"]["count"] == 2 and stages["shadow maps"]["count"] == ahead
    compiled = stages["programs" if ahead else "cascade"]["first_ms"]
    assert compiled > stages["cascade"]["median_ms"] > 0
    again = read_lights(out / "lights.json", UP)
    assert again.reference_lux == 250 and len(again.lights) == len(setup.lights)


@pytest.mark.slow
def test_all_files_of_a_run_are_there_and_whole(run: tuple[dict, Path]) -> None:
    _, out = run
    kinds = ("relit", "filter", "refined", "visibility")
    pictures = {f"{name}.{kind}.{suffix}" for name in ("f0", "f2") for kind in kinds for suffix in ("png", "exr")}
    assert {entry.name for entry in out.iterdir()} == pictures | {"contact_sheet.png", "run.json", "lights.json"}
    for name in pictures:
        picture = read_image(out / name)
        assert picture.shape == (32, 48, 3) and np.isfinite(picture).all() and picture.max() > 0
    linear, shown = (read_image(out / f"f0.relit.{suffix}") for suffix in ("exr", "png"))
    np.testing.assert_allclose(shown, to_display(jnp.asarray(linear)), atol=0.6 / 255 + 1e-3)


@pytest.mark.slow
def test_several_devices_make_the_same_pictures(run: tuple[dict, Path], tmp_path: Path) -> None:
    _, out = run
    code = f"""
import sys
sys.path[:0] = {[str(Path(__file__).parents[0])]!r}
import hyjax.scene.relighter as relighter
import jax
import test_relighting as t
assert jax.device_count() == 2
used = set()
real = relighter.relight_stages
def noted(view, *arguments, **options):
    used.add(view.frame.device)
    return real(view, *arguments, **options)
relighter.relight_stages = noted
out = t.Path({str(tmp_path)!r})
summary = t.relight(t.make_wall(), t.make_setup(), out, capture=t.Twice(), exr=True)
assert len(used) == 2 and summary["frames"] == ["f0", "f2", "g0", "g2"], (used, summary["frames"])
"""
    environment = os.environ | {"XLA_FLAGS": f"{UNOPTIMISED} --xla_force_host_platform_device_count=2"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=400
    )
    assert done.returncode == 0, done.stderr
    for name, again in (("f0", "g0"), ("f2", "g2")):
        one = read_image(out / f"{name}.relit.exr")
        for other in (name, again):
            np.testing.assert_allclose(one, read_image(tmp_path / f"{other}.relit.exr"), rtol=2e-3, atol=1e-4)


def test_programs_compiled_ahead_fit_the_estimated_light(wall: RayCaster, setup: LightSetup) -> None:
    """Arrays of another shape, or another tree of them, would compile all programs again."""
    scene = Scene(Corner(), wall.mesh)
    even = EvenlyLitPlace(scene).surface_light(setup)
    true = dataclasses.replace(scene.surface_light(setup), emitters=None)
    assert jax.tree.structure(even) == jax.tree.structure(true)
    for one, other in zip(jax.tree.leaves(even), jax.tree.leaves(true), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)


@pytest.mark.slow
def test_large_programs_are_compiled_once_from_their_shapes_alone(
    wall: RayCaster, setup: LightSetup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hyjax.util.programs._folder", tmp_path / "kept")
    relight(wall, setup, tmp_path / "out", frames="0")
    kept = [file.name.split("-")[0] for file in (tmp_path / "kept").iterdir()]
    for name in ("pipeline.refine_illuminance", "pipeline.refine_visibility", "light.shading.shade_each"):
        assert kept.count(name) == 1, name


def test_frames_size_and_mode_are_obeyed(wall: RayCaster, setup: LightSetup, tmp_path: Path) -> None:
    summary = relight(wall, setup, tmp_path, frames="2", size=(20, 20), paper_mode=True, shadows=False)
    assert summary["frames"] == ["f2"] and summary["size"] == [20, 20] and summary["mode"] == "paper"
    names = {entry.name for entry in tmp_path.iterdir()}
    assert names == {"f2.relit.png", "contact_sheet.png", "run.json", "lights.json"}
    assert read_image(tmp_path / "f2.relit.png").shape == (20, 20, 3)


def test_dark_frames_name_the_file_of_the_lights(
    wall: RayCaster, setup: LightSetup, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    dim, options = (
        dataclasses.replace(setup, reference_lux=5e4),
        {"frames": "2", "size": (20, 20), "shadows": False},
    )
    relight(wall, dim, tmp_path / "out", paper_mode=True, **options)
    write_lights(tmp_path / "dim.json", dim)
    scene = Scene(Corner(), wall.mesh, size=(20, 20))
    given = RelightSettings(
        lights=str(tmp_path / "dim.json"),
        frames="2",
        shadows=False,
        paper_mode=True,
        quiet=True,
        out=tmp_path / "out",
    )
    relight_capture(given, scene=scene, schedule=SCHEDULE)
    first, second = (record.message for record in caplog.records if "nearly black" in record.message)
    assert "of 5e+04 into lights.json, and give that" in first and f"into {tmp_path / 'dim.json'}, and" in second


def test_pictures_of_an_earlier_run_are_told(
    wall: RayCaster, setup: LightSetup, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    options = {"size": (20, 20), "shadows": False, "paper_mode": True}
    for frames in ("all", "all", "2"):
        relight(wall, setup, tmp_path, frames=frames, **options)
    told = [record.message for record in caplog.records if "earlier run" in record.message]
    line = "has a picture of an earlier run, too (f0.relit.png), which the contact sheet does not show"
    assert told == [f"{tmp_path}: {line}"]


def test_frames_that_burn_out_are_said(
    wall: RayCaster, setup: LightSetup, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Not under usual light."""
    options = {"frames": "2", "size": (20, 20)}
    for reference, bright in ((1e-3, ["f2"]), (setup.reference_lux, [])):
        caplog.clear()
        lights = dataclasses.replace(setup, reference_lux=reference)
        assert relight(wall, lights, tmp_path, **options)["frames_too_bright"] == bright
        assert ("1 of 1 pictures burn out where the photo did not (f2.relit.png)" in caplog.text) == bool(bright)


def test_a_run_says_which_lights_are_made_up(
    wall: RayCaster, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = RelightSettings(lights="noon-window", frames="2", out=tmp_path, quiet=True)
    relight_capture(settings, scene=Scene(Corner(), wall.mesh, size=(20, 20)), schedule=SCHEDULE)
    assert "noon-window: made up: window at (" in caplog.text


def test_pictures_too_dark_and_too_bright() -> None:
    grey, white, black = (np.full((20, 20, 3), value) for value in (0.5, 1.0, 0.0))
    dusk = np.where(np.arange(20)[:, None, None] < 8, 0.05, grey)  # dark in two fifths already
    orange, half = np.array([1.0, 0.6, 0.2]) * white, np.where(np.arange(20)[:, None, None] < 6, 1.0, grey)
    assert dark_share(grey, black).too_dark and dark_share(dusk, black).too_dark
    assert not dark_share(dusk, dusk).too_dark and not dark_share(black, black).too_dark
    for relit in (white, half, orange):
        assert dark_share(grey, relit).too_bright and not dark_share(relit, relit).too_bright
    assert not dark_share(grey, np.where(np.arange(20)[:, None, None] < 6, orange, grey)).too_bright, (
        "a lamp's glow"
    )


def test_all_frames_without_surface_is_an_error(wall: RayCaster, setup: LightSetup, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="corner: no ray of any chosen frame met the mesh") as caught:
        relight(wall, setup, tmp_path, frames="1")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_make_writable(tmp_path: Path) -> None:
    make_writable(tmp_path / "a" / "b")
    make_writable(tmp_path / "a" / "b")
    assert not list((tmp_path / "a" / "b").iterdir())
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with pytest.raises(InputError, match="cannot write there"):
            make_writable(out)


def test_a_folder_in_the_way_of_a_file_is_one_line(wall: RayCaster, setup: LightSetup, tmp_path: Path) -> None:
    for name in ("run.json", "lights.json", "contact_sheet.png", "f0.relit.png"):
        out = tmp_path / name.replace(".", "-")
        (out / name).mkdir(parents=True)
        with pytest.raises(InputError, match=name):
            relight(wall, setup, out, frames="0", shadows=False)
        assert not [entry.name for entry in out.iterdir() if entry.name.startswith(".")]
