"""Redwood's and Open3D's scenes: pictures, depth and poses by order."""

import json
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
from PIL import Image

from hyjax.data.recording import without_margin
from hyjax.data.registry import open_capture
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

K = small.LENS
MATRIX = [K.fx, 0.0, 0.0, 0.0, K.fy, 0.0, K.cx - 0.5, K.cy - 0.5, 1.0]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "lounge")


def write(folder: Path, pictures: str = "color") -> Path:
    for index in range(small.COUNT):
        small.save_picture(folder / f"{pictures}/{index + 9}.jpg", small.picture(index))
        small.save_depth(folder / f"depth/{index + 9}.png", small.depth(index))
    write_log(folder, list(range(small.COUNT)))
    (folder / "camera_primesense.json").write_text(
        json.dumps({"width": K.width, "height": K.height, "intrinsic_matrix": MATRIX})
    )
    return folder


def write_log(folder: Path, numbers: list[int], poses: list[np.ndarray] | None = None) -> None:
    lines = []
    for place, number in enumerate(numbers):
        lines.append(f"{number}\t{number}\t{number + 1}")
        pose = poses[place] if poses else small.pose(number)
        lines += ["\t".join(map(repr, map(float, row))) for row in pose]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("pictures", ["color", "image"])
def test_a_folder_and_an_archive_are_read_alike_in_order_of_number(tmp_path: Path, pictures: str) -> None:
    folder = write(tmp_path / "lounge", pictures)
    for path in (folder, small.zipped(folder)):
        small.check_same(path)
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["9", "10", "11"] and capture.sensor == KINECT


def test_positions_and_quaternions_and_depth_in_pgm_are_read_alike(folder: Path) -> None:
    """As SLAMBench's dining room has them."""
    from scipy.spatial.transform import Rotation

    rows = []
    for index in range(small.COUNT):
        pose, raw = small.pose(index), folder / f"depth/{index + 9}.png"
        rows.append([*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()])
        millimetres = np.asarray(Image.open(raw)).astype(">u2")
        head = f"P5 {millimetres.shape[1]} {millimetres.shape[0]} 65535\n".encode()
        raw.with_suffix(".pgm").write_bytes(head + millimetres.tobytes())
        raw.unlink()
    (folder / "trajectory.log").unlink()
    (folder / "pose.txt").write_text("\n".join(" ".join(map(repr, map(float, row))) for row in rows))
    small.check_same(folder)
    (folder / "pose.txt").write_text("1 2 3\n")
    with pytest.raises(InputError, match=r"pose.txt: row 1 has 3 numbers, need tx ty tz qx qy qz qw"):
        open_capture(folder)


def framed(depths: tuple[int, int, int, int], white: float = 1.0) -> np.ndarray:
    """Picture with a white margin of so many lines at the top, the bottom, the left and the right."""
    picture = np.random.default_rng(0).uniform(0.1, 0.9, (200, 300, 3)).astype(np.float32)
    top, bottom, left, right = depths
    picture[:top] = picture[200 - bottom :] = picture[:, :left] = picture[:, 300 - right :] = white
    return picture


@pytest.mark.parametrize("white", [1.0, 0.93])  # as JPEG has it
def test_a_white_margin_becomes_black(white: float) -> None:
    """As NYU's pictures have; what is white in the picture itself stays, also where it touches the margin."""
    picture = framed((3, 2, 5, 1), white)
    picture[3, :150] = white  # the margin's innermost line, in part
    picture[4:120, 20:250] = 1.0  # a burnt-out window
    cut = without_margin(picture)
    assert (cut[:3] == 0).all() and (cut[-2:] == 0).all() and (cut[:, :5] == 0).all() and (cut[:, -1:] == 0).all()
    assert (cut[3, :150] == 0).all()
    np.testing.assert_array_equal(cut[4:-2, 6:-1], picture[4:-2, 6:-1])


@pytest.mark.parametrize("depths", [(0, 0, 0, 0), (3, 3, 3, 0), (0, 0, 5, 5), (20, 20, 20, 20), (100, 100, 0, 0)])
def test_what_is_no_white_margin_stays(depths: tuple[int, int, int, int]) -> None:
    """White on three sides, a white backdrop, a picture that is white all over."""
    picture = framed(depths)
    np.testing.assert_array_equal(without_margin(picture), picture)


def test_more_poses_than_pictures_are_cut_with_a_line(folder: Path) -> None:
    write_log(folder, [0, 1, 2, 3])
    capture = open_capture(folder)
    assert len(capture) == 3 and "there are 3 pictures (first: pose 3)" in capture.faults[0]


def test_numbers_in_the_log_tell_which_pictures_have_poses(folder: Path) -> None:
    write_log(folder, [0, 2])
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["9", "11"]
    np.testing.assert_allclose(capture[1].camera.pose, small.pose(2), atol=1e-6)
    assert "1 of 3 pictures are left out, without pose (first: color/10.jpg)" in capture.remarks[0]


def test_poses_that_are_nan_are_left_out(folder: Path) -> None:
    write_log(folder, [0, 1, 2], [small.pose(0), np.full((4, 4), np.nan), small.pose(2)])
    capture = open_capture(folder)
    assert len(capture) == 2 and "no rigid motions (first: pose 1)" in capture.faults[0]


def test_depth_of_other_names_belongs_to_pictures_by_order(folder: Path) -> None:
    for index in range(small.COUNT):
        (folder / f"depth/{index + 9}.png").rename(folder / f"depth/d{index:05d}-x.png")
    small.check_same(folder)


def test_a_missing_depth_map_does_not_shift_the_others(folder: Path) -> None:
    (folder / "depth/10.png").unlink()
    capture = open_capture(folder)
    assert capture[1].depth is None and "no depth map (first: color/10.jpg)" in capture.faults[0]
    np.testing.assert_allclose(capture[2].depth, small.depth(2), atol=1e-6)


def test_damaged_pictures_are_left_out(folder: Path) -> None:
    small.cut(folder / "color/9.jpg")
    assert len(open_capture(folder)) == 2


def test_intrinsics_of_rows_instead_of_columns_are_refused(folder: Path) -> None:
    matrix = np.reshape(MATRIX, (3, 3)).T.ravel().tolist()
    (folder / "camera_primesense.json").write_text(json.dumps({"intrinsic_matrix": matrix}))
    with pytest.raises(InputError, match=r"camera_primesense.json: intrinsic_matrix: must be fx 0 0"):
        open_capture(folder)


def test_the_default_intrinsics_are_for_640x480_alone(folder: Path) -> None:
    (folder / "camera_primesense.json").unlink()
    with pytest.raises(InputError, match="missing; the default is for 640x480"):
        open_capture(folder)


def test_a_log_that_is_cut_off_is_refused(folder: Path) -> None:
    small.cut(folder / "trajectory.log")
    with pytest.raises(InputError, match=r"trajectory.log: pose 1 is not three numbers"):
        open_capture(folder)
