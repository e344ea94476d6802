"""ScanNet's .sens files: one binary, read in place."""

import io
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
from PIL import Image

from hyjax.data.capture import Capture
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

DEPTH_LENS = Intrinsics(32, 24, 31.0, 30.0, 15.5, 12.5)


def matrix(lens: Intrinsics) -> np.ndarray:
    k = np.eye(4)
    k[:3, :3] = lens.matrix
    k[:2, 2] -= 0.5
    return k


def sens(
    poses: list[np.ndarray] | None = None,
    *,
    colour: str = "jpg",
    depth: str = "zlib",
    depth_to_rig: np.ndarray | None = None,
    times: list[int] | None = None,
    count: int | None = None,
    version: int = 4,
    depth_packing: int | None = None,
) -> bytes:
    poses = [small.pose(i) for i in range(small.COUNT)] if poses is None else poses
    name = b"StructureSensor"
    parts = [struct.pack("<IQ", version, len(name)), name]
    for part in (
        matrix(small.LENS),
        np.eye(4),
        matrix(DEPTH_LENS),
        np.eye(4) if depth_to_rig is None else depth_to_rig,
    ):
        parts.append(np.asarray(part, "<f4").tobytes())
    packings = {"raw": 0, "png": 1, "jpg": 2}[colour], {"raw": 0, "zlib": 1}[depth]
    packings = packings[0], packings[1] if depth_packing is None else depth_packing
    k, d = small.LENS, DEPTH_LENS
    parts.append(
        struct.pack("<2i4IfQ", *packings, k.width, k.height, d.width, d.height, 1000.0, count or len(poses))
    )
    for index, pose in enumerate(poses):
        pixels = np.round(small.picture(index % 3) * 255).astype(np.uint8)
        file = io.BytesIO()
        if colour != "raw":
            Image.fromarray(pixels).save(file, {"jpg": "jpeg"}.get(colour, colour), quality=98, subsampling=0)
        picture = file.getvalue() or pixels.tobytes()
        steps = np.round(small.depth(index % 3, d).astype(np.float64) * 1000).astype("<u2").tobytes()
        steps = zlib.compress(steps) if depth == "zlib" else steps
        time = 1000 + 33000 * index if times is None else times[index]
        parts.append(np.asarray(pose, "<f4").tobytes() + struct.pack("<4Q", time, time, len(picture), len(steps)))
        parts += [picture, steps]
    return b"".join([*parts, struct.pack("<Q", 0)])


def write(folder: Path, content: bytes) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene0000_00.sens").write_bytes(content)
    return folder


def check(capture: Capture, tolerance: float = 0.02) -> None:
    assert len(capture) == small.COUNT and not capture.faults
    for index, frame in enumerate(capture):
        np.testing.assert_allclose(frame.camera.pose, small.pose(index), atol=1e-6)
        k = frame.camera.intrinsics
        np.testing.assert_allclose([k.fx, k.fy, k.cx, k.cy], [60, 58, 31, 25], atol=1e-4)
        np.testing.assert_allclose(frame.image, small.picture(index), atol=tolerance)
        np.testing.assert_allclose(frame.depth, small.depth(index, DEPTH_LENS), atol=1e-6)
        assert frame.depth_intrinsics == DEPTH_LENS


@pytest.mark.parametrize(("colour", "depth"), [("jpg", "zlib"), ("png", "raw"), ("raw", "zlib")])
def test_a_file_its_folder_and_an_archive_are_read_alike(tmp_path: Path, colour: str, depth: str) -> None:
    folder = write(tmp_path / "scene", sens(colour=colour, depth=depth))
    for path in (folder, folder / "scene0000_00.sens", small.zipped(folder)):
        check(open_capture(path), 0.02 if colour == "jpg" else 1e-6)
    capture = open_capture(folder)
    assert capture.sensor == KINECT and capture.metric
    np.testing.assert_allclose(capture.up, [0, 0, 1])
    np.testing.assert_allclose([frame.time for frame in capture], [0, 0.033, 0.066], atol=1e-9)


def test_frames_whose_pose_is_minus_infinity_are_left_out_and_counted(tmp_path: Path) -> None:
    lost = np.full((4, 4), -np.inf)
    folder = write(tmp_path / "scene", sens([small.pose(0), lost, small.pose(2), lost]))
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["000000", "000002"] and not capture.faults
    assert "2 of 4 frames are left out, they have no pose (first: 1)" in capture.remarks[0]


def test_of_a_truncated_file_the_whole_frames_are_kept(tmp_path: Path) -> None:
    folder = write(tmp_path / "scene", sens()[:-200])
    capture = open_capture(folder)
    assert len(capture) == 2 and capture[1].depth is not None
    assert "truncated: 2 of 3 frames are whole" in capture.faults[0]


def test_a_number_of_frames_beyond_the_file_costs_nothing(tmp_path: Path) -> None:
    folder = write(tmp_path / "scene", sens(count=1 << 62))
    assert len(open_capture(folder)) == 3


def test_depth_of_a_camera_that_stands_elsewhere_is_brought_to_the_pictures(tmp_path: Path) -> None:
    beside = np.eye(4)
    beside[0, 3] = 0.1
    folder = write(tmp_path / "scene", sens(depth_to_rig=beside))
    frame = open_capture(folder)[0]
    assert frame.depth is not None
    lens = frame.depth_camera.intrinsics
    np.testing.assert_allclose([lens.fx, lens.cx], [30.0, 15.5], atol=1e-4)
    # A wall near 2.3 m, seen from 0.1 m beside, moves by 30 * 0.1 / 2.3 = 1.3 pixels to the right.
    away = frame.depth[:, :2]
    assert (away == 0).any() and np.abs(frame.depth[12, 16] - small.depth(0, DEPTH_LENS)[12, 15]) < 0.05


def test_clocks_that_go_back_are_told_and_numbers_take_their_place(tmp_path: Path) -> None:
    folder = write(tmp_path / "scene", sens(times=[5000, 4000, 9000]))
    capture = open_capture(folder)
    assert "the clock goes back" in capture.faults[0] and not capture.times_known
    np.testing.assert_allclose([frame.time for frame in capture], [0, 1 / 30, 2 / 30])


DEPTH_SIDES = struct.pack("<2I", DEPTH_LENS.width, DEPTH_LENS.height)
"""Where 16384 are put, a MiB of packed zeros took 6 GiB."""


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (sens(version=3), "version 3"),
        (sens(depth_packing=2), "occi"),
        (sens(depth_packing=9), "packed as 9"),
        (sens()[:100], "ends within its header"),
        (b"", "ends within its header"),
        (sens()[:4] + b"\xff" * 8 + sens()[12:], "letters"),
        (sens([np.full((4, 4), -np.inf)]), "none of 1 frames"),
        (sens().replace(DEPTH_SIDES, struct.pack("<2I", 16384, 16384)), "depth: pictures of 16384x16384 pixels"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(tmp_path: Path, content: bytes, told: str) -> None:
    folder = write(tmp_path / "scene", content)
    with pytest.raises(InputError, match=told) as caught:
        open_capture(folder)
    assert "scene0000_00.sens" in str(caught.value)


def test_depth_that_unpacks_to_far_more_is_refused(tmp_path: Path) -> None:
    content = sens()
    steps = zlib.compress(bytes(1 << 26))
    pose = np.asarray(small.pose(0), "<f4").tobytes()
    start = content.index(pose)
    size = struct.unpack_from("<4Q", content, start + 64)[2]
    picture = content[start + 96 : start + 96 + size]
    bomb = content[:start] + pose + struct.pack("<4Q", 0, 0, size, len(steps)) + picture + steps
    capture = open_capture(write(tmp_path / "scene", bomb))
    with pytest.raises(InputError, match="frame 0: depth of another size than 32x24"):
        capture[0]


def test_opening_a_long_file_holds_no_pictures(tmp_path: Path) -> None:
    # Random poses do not matter here; 400 frames of raw colour are 3.7 MB.
    folder = write(tmp_path / "scene", sens([small.pose(0)] * 400, colour="raw"))
    open_capture(folder)
    tracemalloc.start()
    capture = open_capture(folder)
    capture[200]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(capture) == 400 and peak < 2_500_000
