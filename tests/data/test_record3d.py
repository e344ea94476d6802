"""Record3D's exports, on small recordings written to their layouts."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from extras import need
from reference.phone_layouts import UP, agree, arkit_pose, box_room, edit_json, seven, write_record3d, zipped
from refusals import refuses_capture as refuses
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture
from hyjax.data.lzfse_blocks import unpacked_size
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera
from hyjax.util.errors import InputError

need("captures")
import lzfse

FRAMES = box_room(4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_record3d(tmp_path / "EXR_RGBD", FRAMES)


@pytest.fixture
def unpacked(tmp_path: Path) -> Path:
    return write_record3d(tmp_path / "walk", FRAMES, r3d=True)


def test_exr_and_rgb_are_read_from_folder_and_archive(folder: Path) -> None:
    for path in (folder, zipped(folder)):
        capture = open_capture(path)
        agree(capture, FRAMES, confidence=False)  # half floats, and no confidence in this export
        assert capture[0].confidence is None and capture.quarter_turns == 0
        assert not capture.faults and not capture.remarks
        assert [frame.time for frame in capture] == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_r3d_is_read_packed_and_unpacked(unpacked: Path) -> None:
    for path in (unpacked, zipped(unpacked, "r3d")):
        agree(open_capture(path), FRAMES)


def test_numbers_may_be_missing_and_poses_be_more_than_pictures(tmp_path: Path) -> None:
    capture = open_capture(write_record3d(tmp_path / "export", FRAMES, numbers=[0, 3, 4, 9]))
    agree(capture, FRAMES, confidence=False)
    assert [frame.name for frame in capture] == [f"frame_{number:06d}" for number in (0, 3, 4, 9)]
    assert capture.remarks == ("6 poses have no picture (first: number 1)",)


def test_pictures_beyond_the_poses_are_left_out_and_counted(folder: Path) -> None:
    edit_json(folder / "metadata.json", poses=[seven(frame.camera) for frame in FRAMES[:3]])
    capture = open_capture(folder)
    assert len(capture) == 3 and "1 frames have no pose" in capture.faults[0] and "rgb/3.jpg" in capture.faults[0]


def test_k_is_column_by_column_and_serves_where_frames_have_none(folder: Path) -> None:
    k = FRAMES[0].camera.intrinsics
    edit_json(folder / "metadata.json", perFrameIntrinsicCoeffs=[], frameTimestamps=None)
    agree(open_capture(folder), FRAMES, confidence=False)
    edit_json(folder / "metadata.json", K=[k.fx, 0, k.cx, 0, k.fy, k.cy, 0, 0, 1])
    agree(open_capture(folder), FRAMES, confidence=False)  # as other programs write it


def test_each_frame_has_its_own_intrinsics(folder: Path) -> None:
    edit_json(folder / "metadata.json", perFrameIntrinsicCoeffs=[[70 + i, 71 + i, 48, 36] for i in range(4)])
    assert [frame.camera.intrinsics.fx for frame in open_capture(folder)] == [70, 71, 72, 73]


def test_no_reading_is_zero(unpacked: Path) -> None:
    depth = FRAMES[1].depth.copy()
    depth[0, :4] = np.nan, np.inf, -1.0, 0.0
    (unpacked / "rgbd" / "1.depth").write_bytes(lzfse.compress(depth.tobytes()))
    found = open_capture(unpacked)[1].depth
    assert not found[0, :4].any()
    np.testing.assert_array_equal(found[1:], depth[1:])


def test_older_files_do_not_tell_the_size_of_depth(unpacked: Path) -> None:
    edit_json(unpacked / "metadata", dw=None, dh=None)
    agree(open_capture(unpacked), FRAMES)


@pytest.mark.slow
def test_damaged_depth_is_named(unpacked: Path) -> None:
    (unpacked / "rgbd" / "1.depth").write_bytes(b"bvx2 and nothing")
    refuses(unpacked, "rgbd/1.depth", "LZFSE")
    (unpacked / "rgbd" / "1.depth").write_bytes(lzfse.compress(bytes(40)))
    refuses(unpacked, "rgbd/1.depth", "need 48x36")
    (unpacked / "rgbd" / "1.depth").write_bytes(lzfse.compress(bytes(1 << 26)))  # a bomb
    refuses(unpacked, "rgbd/1.depth", "larger than a depth map can be")


def test_small_bombs_are_not_unpacked(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = lzfse.compress(bytes(1 << 20))
    (unpacked / "rgbd" / "1.depth").write_bytes(bomb)
    monkeypatch.setattr(lzfse, "decompress", lambda content: pytest.fail("unpacked"))
    with pytest.raises(InputError, match="unpacks to more than a depth map has"):
        open_capture(unpacked).depth_reading(1)


@pytest.mark.parametrize("size", [0, 1, 10, 5000, 1 << 17, 1 << 22])
def test_what_lzfse_unpacks_to_is_known_before(size: int) -> None:
    rng = np.random.default_rng(0)
    for content in (
        bytes(size),
        rng.bytes(size),
        np.round(rng.normal(2, 0.5, size // 4), 2).astype("<f4").tobytes(),
    ):
        packed = lzfse.compress(content)
        assert unpacked_size(packed) == len(content)
        assert unpacked_size(packed[:-4]) is None and unpacked_size(b"bvx9" + packed) is None
    blocks = (b"bvx2" + struct.pack("<I3Q", 1, 0, 0, 0)) * 9  # of no length, and too many
    assert unpacked_size(blocks + b"bvx$") is None


def test_without_lzfse_one_line_says_what_to_install(unpacked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lzfse", None)
    refuses(unpacked, "needs the package lzfse", "pip install '.[captures]'")


def relative(folder: Path) -> np.ndarray:
    """Poses are told from the first camera on, as older versions of the app do; returns the first."""
    first = arkit_pose(FRAMES[0].camera)
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = [Camera(f.camera.intrinsics, np.linalg.inv(first) @ arkit_pose(f.camera) @ flip) for f in FRAMES]
    edit_json(folder / "metadata.json", poses=[seven(camera) for camera in cameras])
    return first


def test_the_initial_pose_places_a_world_that_begins_at_the_first_camera(folder: Path) -> None:
    first = relative(folder)
    start = [*Rotation.from_matrix(first[:3, :3]).as_quat().tolist(), *first[:3, 3].tolist()]
    edit_json(folder / "metadata.json", initPose=start)
    agree(open_capture(folder), FRAMES, confidence=False)


def test_without_it_gravity_is_taken_from_how_the_camera_was_held(folder: Path) -> None:
    relative(folder)
    capture: Capture = open_capture(folder)
    assert "gravity is taken from how the camera was held" in capture.remarks[0]
    assert capture.up @ UP > 0.9


def test_the_selfie_camera_has_no_poses(folder: Path) -> None:
    edit_json(folder / "metadata.json", poses=[[0, 0, 0, 1, 0, 0, 0]] * 4)
    refuses(folder, "poses are all the same")


@pytest.mark.parametrize(
    "key, value",
    [
        ("K", None),
        ("K", [1, 2]),
        ("K", ["a"] * 9),
        ("w", "wide"),
        ("w", 10**6),
        ("h", 0),
        ("poses", {}),
        ("poses", [[1, 2, 3]]),
        ("poses", [1]),
        ("perFrameIntrinsicCoeffs", [[1, 2, 3, None]]),
        ("frameTimestamps", [True]),
        ("fps", 0),
    ],
)
def test_bad_content_names_file_and_key(folder: Path, key: str, value: object) -> None:
    edit_json(folder / "metadata.json", **{key: value})
    if value is None:
        content = json.loads((folder / "metadata.json").read_text())
        assert key not in content
    refuses(folder, "metadata.json", key)
