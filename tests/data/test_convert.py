"""Captures written in other layouts, and read back."""

import dataclasses
import functools
import sys
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
import trimesh
from extras import need
from jaxtyping import Float
from reference.phone_layouts import box_room, write_scanner3d
from scipy.spatial.transform import Rotation
from test_nerfstudio import write as write_source

from hyjax.cli import main
from hyjax.data import builtin_room
from hyjax.data.capture import Capture, Frame
from hyjax.data.convert import SelectedFrames, convert, write_capture
from hyjax.data.convert_settings import ConvertSettings
from hyjax.data.registry import open_capture
from hyjax.data.writers import seen_through, turned_up
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.util.errors import InputError

DEPTH_LENS = Intrinsics(32, 24, 30.0, 29.0, 15.5, 12.5)
"""Of depth that is registered to `small.LENS` but half as large."""
LAYOUTS = ("7scenes", "nerfstudio", "arkit")
ALL_LAYOUTS = (*LAYOUTS, "stray")


@pytest.fixture(autouse=True)
def stray_needs_its_extra(request: pytest.FixtureRequest) -> None:
    if hasattr(request.node, "callspec") and request.node.callspec.params.get("layout") == "stray":
        need("captures")


class Source(Capture):
    """The small capture with all that a layout may have a place for."""

    name = "source"
    up = small.UP
    fingerprint = "source"

    def __init__(self, depths: int = small.COUNT, lens: Intrinsics | None = DEPTH_LENS, count: int = small.COUNT):
        self._depths, self._lens, self._count = depths, lens, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Frame:
        camera = Camera(small.LENS, small.pose(index))
        frame = Frame(f"p{index}", small.picture(index), camera, index / 3, exposure=0.01 * (index + 1))
        if index >= self._depths:
            return frame
        depth = small.depth(index, self._lens or small.LENS)
        confidence = np.ones_like(depth)
        confidence[:, :10] = 0.5
        return dataclasses.replace(frame, depth=depth, depth_intrinsics=self._lens, confidence=confidence)

    def mesh(self) -> trimesh.Trimesh:
        return trimesh.creation.box((4, 3, 2))

    has_mesh = True


def through_picture(depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h2 w2"]:
    return np.repeat(np.repeat(depth, 2, 0), 2, 1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_written_is_read_back(layout: str, tmp_path: Path) -> None:
    source, out = Source(), tmp_path / "out"
    write_capture(source, layout, out, False)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    for path in (out, small.zipped(out)):
        capture = open_capture(path, strict=True)
        assert len(capture) == len(source) and capture.metric
        np.testing.assert_allclose(capture.up, source.up, atol=1e-9)
        for frame, original in zip(capture, source):
            np.testing.assert_allclose(frame.camera.pose, original.camera.pose, atol=1e-6)
            assert frame.camera.intrinsics == original.camera.intrinsics
            np.testing.assert_allclose(frame.image, original.image, atol=1e-6)
            assert frame.depth is not None and original.depth is not None
            expected = through_picture(original.depth) if layout == "7scenes" else original.depth
            np.testing.assert_allclose(frame.depth, expected, atol=0.0005)
            if layout == "arkit":
                np.testing.assert_allclose(frame.time, original.time, atol=0.001)
                assert frame.depth_intrinsics == original.depth_intrinsics
                np.testing.assert_array_equal(frame.confidence, original.confidence)
            assert frame.exposure == (original.exposure if layout == "nerfstudio" else None)
    assert capture.has_mesh == (layout == "arkit") and (out / "mesh.ply").is_file() == (layout != "arkit")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_frames_without_depth_stay(layout: str, tmp_path: Path) -> None:
    for depths in (0, 1):
        write_capture(Source(depths), layout, tmp_path / f"out{depths}", False)
        capture = open_capture(tmp_path / f"out{depths}")
        assert len(capture) == small.COUNT
        last = capture[2].depth
        assert (capture[0].depth is None) == (depths == 0) and (last is None or not last.any())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_frame_is_a_capture(layout: str, tmp_path: Path) -> None:
    write_capture(Source(count=1), layout, tmp_path / "out", False)
    assert len(open_capture(tmp_path / "out")) == 1


def test_depth_of_another_lens_is_seen_through_the_pictures(tmp_path: Path) -> None:
    wide = Intrinsics(32, 24, 20.0, 20.0, 14.0, 13.0)
    source = Source(lens=wide)
    for layout in ("7scenes", "nerfstudio"):
        write_capture(source, layout, tmp_path / layout, False)
        frame, original = open_capture(tmp_path / layout)[0], source[0]
        assert frame.depth is not None and original.depth is not None
        # A reading is where its ray meets the picture.
        point = original.depth_camera.unproject(original.depth)[12, 20]
        (x, y), _ = frame.depth_camera.project(point)
        np.testing.assert_allclose(frame.depth[int(y), int(x)], original.depth[12, 20], atol=0.0005)


def test_pictures_of_several_lenses_get_one_in_7scenes(tmp_path: Path) -> None:
    class Zooming(Source):
        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            k = dataclasses.replace(small.LENS, fx=60.0 + index, cx=31.0 + index)
            return dataclasses.replace(frame, camera=Camera(k, frame.camera.pose))

    source = Zooming()
    write_capture(source, "7scenes", tmp_path / "out", False)
    frame, original = open_capture(tmp_path / "out")[2], source[2]
    assert frame.camera.intrinsics == small.LENS
    # Red rises by 1/64 a pixel: the same direction has the same red.
    x = (40.5 - 31.0) / 60.0 * 62.0 + 33.0
    np.testing.assert_allclose(frame.image[24, 40, 0], (x - 0.5) / 64, atol=0.006)
    assert original.camera.intrinsics != small.LENS


def test_worlds_are_turned_for_layouts_with_z_up(tmp_path: Path) -> None:
    class Turned(Source):
        turn = Rotation.from_euler("xyz", [100, 20, 30], degrees=True).as_matrix()
        up = turn @ small.UP

        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            pose = frame.camera.pose.copy()
            pose[:3] = self.turn @ pose[:3]
            return dataclasses.replace(frame, camera=Camera(small.LENS, pose))

    source = Turned()
    write_capture(source, "arkit", tmp_path / "out", False)
    capture = open_capture(tmp_path / "out")
    turn = turned_up(source.up, small.UP)
    np.testing.assert_allclose(turn[:3, :3] @ source.up, small.UP, atol=1e-9)
    for frame, original in zip(capture, source):
        np.testing.assert_allclose(frame.camera.pose, turn @ original.camera.pose, atol=1e-6)
    mesh = capture.mesh()
    assert mesh is not None
    expected = trimesh.transform_points(source.mesh().vertices, turn)
    np.testing.assert_allclose(np.sort(mesh.vertices, 0), np.sort(expected, 0), atol=1e-5)


def test_up_that_is_down_is_turned_too() -> None:
    np.testing.assert_allclose(
        turned_up(np.array([0.0, 0, -1]), small.UP)[:3, :3] @ [0, 0, -1], small.UP, atol=1e-9
    )


def test_readings_of_no_confidence_are_left_out_where_there_is_no_place_for_it(tmp_path: Path) -> None:
    class Doubtful(Source):
        def __getitem__(self, index: int) -> Frame:
            frame = super().__getitem__(index)
            assert frame.confidence is not None
            return dataclasses.replace(frame, confidence=np.where(frame.confidence < 1, 0.0, 1.0))

    write_capture(Doubtful(), "nerfstudio", tmp_path / "out", False)
    depth = open_capture(tmp_path / "out")[0].depth
    assert depth is not None and not depth[:, :10].any() and depth[:, 10:].all()


def test_frames_and_size_are_chosen(tmp_path: Path) -> None:
    source = write_source(tmp_path / "office")
    settings = ConvertSettings(
        capture=source, to="arkit", out=tmp_path / "out", frames="0:3:2", size="32", quiet=True
    )
    assert convert(settings) == 2
    capture = open_capture(tmp_path / "out")
    np.testing.assert_allclose(capture[1].camera.pose, small.pose(2), atol=1e-6)
    k = capture[0].camera.intrinsics
    assert k.shape == (32, 32) and np.allclose([k.fx, k.cx], [60 * 32 / 48, (31 - 8) * 32 / 48])
    assert capture[0].depth_camera.intrinsics == small.LENS
    np.testing.assert_allclose(capture[0].depth, small.depth(0), atol=0.0005)


def test_the_builtin_room_is_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small_room = functools.partial(builtin_room.load_room, n_frames=2, width=160, height=120, quality=0.25)
    monkeypatch.setattr(builtin_room, "load_room", lambda **_: small_room(progress=False))
    for layout in LAYOUTS:
        convert(ConvertSettings(to=layout, out=tmp_path / layout, quiet=True))
        room, capture = small_room(progress=False), open_capture(tmp_path / layout)
        for frame, original in zip(capture, room, strict=True):
            np.testing.assert_allclose(frame.camera.pose, original.camera.pose, atol=1e-6)
            np.testing.assert_allclose(frame.depth, original.depth, atol=0.00051)
            np.testing.assert_allclose(frame.image, original.image, atol=1e-6)


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_the_command_says_how_to_relight(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = write_source(tmp_path / "office"), tmp_path / "out"
    monkeypatch.setattr(
        sys, "argv", ["hyjax", "convert", str(source), "--to", layout, "--out", str(out), "--quiet"]
    )
    main()
    assert f"3 frames in {out}; relight with: hyjax relight --capture {out}" in capsys.readouterr().out
    assert len(open_capture(out)) == 3


def test_an_output_folder_that_is_in_use_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/keep.txt").write_text("mine")
    with pytest.raises(InputError, match="not an empty folder"):
        convert(ConvertSettings(capture=tmp_path, to="arkit", out=tmp_path / "out"))
    assert (tmp_path / "out/keep.txt").read_text() == "mine"


class Damaged(Source):
    """A frame cannot be read."""

    broken: tuple[int, ...] = (0,)

    def __getitem__(self, index: int) -> Frame:
        if index in self.broken:
            raise InputError(f"frame {index}: damaged")
        return super().__getitem__(index)


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_a_failure_leaves_nothing_behind(layout: str, tmp_path: Path) -> None:
    strict, nothing = Damaged(), Damaged()
    strict.strict, nothing.broken = True, (0, 1, 2)
    with pytest.raises(InputError, match="frame 0"):
        write_capture(strict, layout, tmp_path / layout, False)
    with pytest.raises(InputError, match="source: none of the chosen frames can be read"):
        write_capture(nothing, layout, tmp_path / layout, False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_damaged_frames_are_left_out_with_a_line(
    layout: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert write_capture(Damaged(), layout, tmp_path / "out", False) == 2
    assert caplog.messages == ["frame 0: damaged; this frame is left out"]
    capture = open_capture(tmp_path / "out", strict=True)
    assert len(capture) == capture.depth_count == 2
    np.testing.assert_allclose(
        [f.image.mean() for f in capture], [small.picture(k).mean() for k in (1, 2)], atol=0.02
    )


def test_selected_frames_keep_mesh_and_size() -> None:
    chosen = SelectedFrames(Source(), [1], (24, 24))
    assert chosen.has_mesh and chosen.mesh() is not None and chosen[0].image.shape == (24, 24, 3)
    assert chosen.fingerprint != SelectedFrames(Source(), [1], None).fingerprint


def test_seeing_through_the_same_lens_changes_nothing() -> None:
    image = small.picture(0)
    assert seen_through(image, small.LENS, small.LENS) is image


def test_depth_without_a_picture_is_told_to_be_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scan = write_scanner3d(tmp_path / "scan", box_room(4), picture_every=3)
    assert convert(ConvertSettings(capture=scan, to="nerfstudio", out=tmp_path / "out", quiet=True)) == 2
    assert "depth maps without a picture" in caplog.text


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_times_that_no_one_recorded_are_told_where_they_are_written(
    layout: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = Source()
    source.times_known = False
    write_capture(source, layout, tmp_path / "out", False)
    told = ["source: no times were recorded; made-up ones are written, in the order of the frames"]
    assert caplog.messages == told * (layout in ("arkit", "stray"))
