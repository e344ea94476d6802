"""3D Scanner App's raw export: a real scan, and small ones with one thing wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
from reference.phone_layouts import box_room, edit_json, write_scanner3d
from refusals import leaves_out_a_frame
from refusals import refuses_capture as refuses

from hyjax.data.registry import open_capture
from hyjax.data.scanner3d import open_scanner3d
from hyjax.data.trees import open_tree
from hyjax.geometry.raycast import RayCaster

FRAMES = box_room(4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_scanner3d(tmp_path / "scan", FRAMES)


def test_moments_without_a_picture_give_their_depth_to_fusion_only(tmp_path: Path) -> None:
    capture = open_capture(write_scanner3d(tmp_path / "scan", FRAMES, picture_every=3))
    assert [frame.name for frame in capture] == ["frame_00000", "frame_00003"] and capture.depth_count == 4
    reading = capture.depth_reading(1)
    np.testing.assert_allclose(reading.depth, FRAMES[1].depth, atol=1e-3)
    np.testing.assert_allclose(reading.camera.pose, FRAMES[1].camera.pose, atol=1e-9)
    assert capture.remarks == ("2 poses have no picture; their depth is used (first: frame_00001.json)",)


def test_a_picture_without_a_pose_is_told(folder: Path) -> None:
    (folder / "frame_00002.json").unlink()
    capture = open_capture(folder)
    assert (
        len(capture) == 3 and "1 pictures have no pose and are left out (first: frame_00002.jpg)" in capture.faults
    )


def test_exposures_are_told(folder: Path) -> None:
    assert [frame.exposure for frame in open_capture(folder)] == [0.0125] * 4


def test_poor_motion_is_told(folder: Path) -> None:
    edit_json(folder / "frame_00002.json", motionQuality=0.2)
    assert open_capture(folder).remarks == (
        "1 frames were taken in fast motion (motionQuality below 0.7) (first: frame_00002.json)",
    )


def test_without_any_pose_that_line_says_why(folder: Path) -> None:
    for moment in folder.glob("frame_*.json"):
        edit_json(moment, cameraPoseARFrame=[float("nan")] * 16)
    refuses(folder, "no frame is usable", "4 poses are unusable")


def test_missing_and_damaged_depth_and_confidence(folder: Path) -> None:
    (folder / "depth_00001.png").unlink()
    (folder / "depth_00002.png").write_bytes(b"\x89PNG")
    (folder / "conf_00003.png").unlink()
    capture = open_capture(folder)
    assert len(capture) == 4 and capture.depth_count == 2
    assert capture[1].depth is None and capture[2].depth is None and capture[3].confidence is None
    assert capture.faults == ("1 depth maps are damaged and left out (first: depth_00002.png)",)
    assert "2 pictures have no depth" in capture.remarks[0]


def test_place_and_date_reach_nothing(folder: Path) -> None:
    edit_json(folder / "frame_00001.json", motionQuality=0.1)
    capture = open_capture(folder)
    told = " ".join([*capture.remarks, *capture.faults, *map(str, (f.name for f in capture))])
    assert "48.1" not in told and "2024" not in told


@pytest.mark.parametrize(
    "key, value",
    [
        ("cameraPoseARFrame", [1, 2, 3]),
        ("cameraPoseARFrame", "none"),
        ("cameraPoseARFrame", [[1]] * 16),
        ("intrinsics", None),
        ("intrinsics", [0] * 9),
        ("intrinsics", [1e300] * 9),
        ("time", "noon"),
        ("time", True),
        ("time", 1e25),
        ("exposureDuration", [1]),
        ("motionQuality", {}),
    ],
)
def test_bad_content_names_file_and_key(folder: Path, key: str, value: object) -> None:
    edit_json(folder / "frame_00002.json", **{key: value})
    leaves_out_a_frame(folder, 3, "frame_00002.json", key)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 5000, '{"time": ' + "9" * 5000 + "}", "\0"])
def test_what_is_no_json_is_named(folder: Path, text: str) -> None:
    (folder / "frame_00002.json").write_text(text)
    leaves_out_a_frame(folder, 3, "frame_00002.json")


def test_intrinsics_of_another_picture_size_are_refused(folder: Path) -> None:
    edit_json(folder / "frame_00002.json", intrinsics=[1447, 0, 966, 0, 1447, 691, 0, 0, 1])
    leaves_out_a_frame(folder, 3, "frame_00002.json", "do not belong to 96x72 pictures")


def test_without_any_picture(folder: Path) -> None:
    for picture in folder.glob("*.jpg"):
        picture.unlink()
    refuses(folder, "no pictures")


# ---- the real scan ----


def test_the_real_scan_opens_upright(scanner3d_chair: Path) -> None:
    capture = open_scanner3d(open_tree(scanner3d_chair))
    assert len(capture) == 24 and capture.depth_count == 70 and not capture.faults
    assert capture.remarks == ("46 poses have no picture; their depth is used (first: frame_00001.json)",)
    frame = capture[0]
    assert frame.image.shape == (1440, 1920, 3) and frame.depth.shape == (192, 256)
    assert set(np.unique(frame.confidence)) == {0.0, 0.5, 1.0} and frame.exposure == pytest.approx(1 / 61, rel=0.01)
    for index in range(len(capture)):
        reading = capture.depth_reading(index)
        assert -reading.camera.pose[1, 1] > 0.5  # the camera's up is the world's


def test_the_real_scans_principal_point_is_that_of_arkits_projection(scanner3d_chair: Path) -> None:
    """Half a pixel is added to the intrinsics that the app tells: only so the two agree."""
    capture = open_scanner3d(open_tree(scanner3d_chair))
    projection = json.loads((scanner3d_chair / "frame_00000.json").read_text())["projectionMatrix"]
    k = capture[0].camera.intrinsics
    assert k.cx == pytest.approx((1 - projection[2]) * k.width / 2, abs=1e-3)
    assert k.cy == pytest.approx((1 + projection[6]) * k.height / 2, abs=1e-3)


def test_the_real_scans_depth_lies_on_the_apps_mesh(scanner3d_chair: Path) -> None:
    capture = open_scanner3d(open_tree(scanner3d_chair))
    caster = RayCaster(capture.mesh())
    errors = []
    for index in range(0, capture.depth_count, 10):
        reading = capture.depth_reading(index)
        seen = caster.gbuffer(reading.camera)
        trusted = seen.hit & (reading.confidence == 1) & (reading.depth < 5)
        errors.append(np.abs(seen.depth - reading.depth)[trusted])
    assert np.median(np.concatenate(errors)) < 0.015
