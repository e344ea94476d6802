"""TUM RGB-D sequences: three lists with clocks of their own."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
from scipy.spatial.transform import Rotation

from hyjax.data.json_fields import Fields
from hyjax.data.posed_lists import floats
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

K = small.LENS
START = 1305031102.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "desk")


def pose_row(time: float, pose: np.ndarray) -> str:
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return " ".join([f"{time:.6f}", *map(repr, map(float, [*pose[:3, 3], *quaternion]))])


def write(folder: Path) -> Path:
    """Poses at 0, 0.1, 0.2 s, pictures with them, depth 15 ms later."""
    rgb, depth, poses = (
        ["# a comment", f"# timestamp {what}"] for what in ("file", "file", "tx ty tz qx qy qz qw")
    )
    for index in range(small.COUNT):
        time = START + index / 10
        small.save_picture(folder / f"rgb/{time:.6f}.png", small.picture(index))
        small.save_depth(folder / f"depth/{time + 0.015:.6f}.png", small.depth(index), 5000)
        rgb.append(f"{time:.6f} rgb/{time:.6f}.png")
        depth.append(f"{time + 0.015:.6f}\tdepth/{time + 0.015:.6f}.png")
        poses.append(pose_row(time, small.pose(index)))
    for name, lines in (("rgb.txt", rgb), ("depth.txt", depth), ("groundtruth.txt", poses)):
        (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "camera.txt").write_text(f"# fx fy cx cy\n{K.fx} {K.fy} {K.cx - 0.5} {K.cy - 0.5}\n")
    return folder


def edit(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


def test_a_folder_and_an_archive_are_read_alike(folder: Path) -> None:
    for path in (folder, small.zipped(folder)):
        small.check_same(path, tolerance=1e-6)
    capture = open_capture(folder)
    assert capture.sensor == KINECT and capture.metric
    assert [frame.name for frame in capture] == ["000000", "000001", "000002"]  # not the date
    np.testing.assert_allclose([frame.time for frame in capture], [0, 0.1, 0.2], atol=1e-6)


def test_poses_are_interpolated_between_those_of_another_clock(folder: Path) -> None:
    ends = [pose_row(START - 0.05, small.pose(0)), pose_row(START + 0.25, small.pose(0))]
    (folder / "groundtruth.txt").write_text("\n".join(ends))
    for frame in open_capture(folder):
        np.testing.assert_allclose(frame.camera.pose, small.pose(0), atol=1e-6)
    edit(folder / "groundtruth.txt", lambda rows: [rows[0], pose_row(START + 0.05, small.pose(1))])
    capture = open_capture(folder)
    between = (small.pose(0)[:3, 3] + small.pose(1)[:3, 3]) / 2
    np.testing.assert_allclose(capture[0].camera.origin, between, atol=1e-6)
    assert len(capture) == 1 and "2 of 3 pictures are left out" in capture.remarks[0]


def test_depth_more_than_20_ms_away_belongs_to_no_picture(folder: Path) -> None:
    edit(folder / "depth.txt", lambda rows: [*rows[:2], f"{START + 0.021:.6f} {rows[2].split()[1]}", *rows[3:]])
    capture = open_capture(folder)
    assert capture[0].depth is None and capture.depth_count == 2
    assert "no depth map within 20 ms" in capture.remarks[0]


def test_time_stamps_that_go_back_are_left_out_with_a_line(folder: Path) -> None:
    edit(folder / "groundtruth.txt", lambda rows: [*rows[:3], rows[2], *rows[3:]])
    edit(folder / "rgb.txt", lambda rows: [*rows, rows[3]])
    capture = open_capture(folder)
    assert len(capture) == 3 and len(capture.faults) == 2
    assert all("not after the row above" in fault for fault in capture.faults)


def test_a_depth_of_65535_is_no_reading(folder: Path) -> None:
    path = next((folder / "depth").iterdir())
    metres = small.depth(0)
    metres[20:22, 20:22] = 65535 / 5000
    small.save_depth(path, metres, 5000)
    capture = open_capture(folder)
    depths = [frame.depth for frame in capture]
    assert all(d is not None and d.max() < 5 for d in depths)


def test_poses_that_are_nan_are_left_out(folder: Path) -> None:
    edit(
        folder / "groundtruth.txt",
        lambda rows: [*rows, f"{START + 1} nan 0 0 0 0 0 1", f"{START + 2} 0 0 0 0 0 0 0"],
    )
    capture = open_capture(folder)
    assert len(capture) == 3 and "2 rows of groundtruth.txt are left out, they are no poses" in capture.faults[0]


def test_times_in_nanoseconds_are_numbers_of_a_capture() -> None:
    assert floats(["1700000000123456789", "1e300"], "poses.txt", 1) == [1700000000123456789.0, float("inf")]
    assert Fields({"time": 1700000000123456789}, "a.json").number("time") == 1700000000123456789.0


def test_listed_files_that_are_missing_or_damaged_are_counted(folder: Path) -> None:
    pictures = sorted((folder / "rgb").iterdir())
    pictures[0].unlink()
    small.cut(pictures[1])
    capture = open_capture(folder)
    assert len(capture) == 1 and len(capture.faults) == 2


def test_clocks_without_overlap_are_refused_with_their_spans(folder: Path) -> None:
    (folder / "groundtruth.txt").write_text(f"{pose_row(1.0, small.pose(0))}\n{pose_row(1.1, small.pose(1))}\n")
    with pytest.raises(InputError, match=r"no picture has a pose.*1305031102\.000.*1\.100"):
        open_capture(folder)


def test_published_intrinsics_go_by_the_folders_name_and_count_from_pixel_centres(tmp_path: Path) -> None:
    big = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
    for name, expected in (
        ("rgbd_dataset_freiburg1_desk", (517.3, 516.5, 319.1, 255.8)),
        ("rgbd_dataset_freiburg3_office", (535.4, 539.2, 320.6, 248.1)),
        ("office", (525.0, 525.0, 320.0, 240.0)),
    ):
        folder = write(tmp_path / name)
        (folder / "camera.txt").unlink()
        for file in (folder / "rgb").iterdir():
            small.save_picture(file, small.picture(0, big))
        for file in (folder / "depth").iterdir():
            small.save_depth(file, small.depth(0, big), 5000)
        capture = open_capture(folder)
        k = capture[0].camera.intrinsics
        np.testing.assert_allclose((k.fx, k.fy, k.cx, k.cy), expected)
        assert np.allclose(capture.up, [0, 0, 1]) == (name != "office")
        assert any("525 525 319.5 239.5" in line for line in capture.remarks) == (name == "office")


def test_depth_is_undistorted_with_its_picture(folder: Path) -> None:
    plain = open_capture(folder)[0]
    with (folder / "camera.txt").open("a") as file:
        file.write("0.25 0 0 0 0\n")
    bent = open_capture(folder)[0]
    assert plain.depth is not None and bent.depth is not None
    # Colour and depth both rise with x, so they move together.
    row, column = 25, 55
    assert bent.image[row, column, 0] > plain.image[row, column, 0] + 0.01
    assert bent.depth[row, column] > plain.depth[row, column] + 0.005
    reading = open_capture(folder).depth_reading(0)
    np.testing.assert_array_equal(reading.depth, bent.depth)


def test_unknown_sizes_without_intrinsics_are_refused(folder: Path) -> None:
    (folder / "camera.txt").unlink()
    with pytest.raises(InputError, match=r"camera.txt: missing.*64x48"):
        open_capture(folder)
