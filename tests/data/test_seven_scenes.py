"""The 7-Scenes reader, on small captures that the tests write and on the kitchen where it is at hand."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from reference.arkit_export import write_depth
from refusals import refuses_capture as refuses

from hyjax.data.capture import Capture
from hyjax.data.kinect import RegisteredKinect
from hyjax.data.registry import open_capture
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

WIDTH, HEIGHT = 16, 12


def pose_at(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Frames 2, 4 and 10, written out of order; frame n is n/100 bright, n metres along x."""
    for number in (10, 2, 4):
        stem = tmp_path / f"frame-{number:06d}"
        write_png(stem.with_suffix(".color.png"), np.full((HEIGHT, WIDTH, 3), number / 100))
        depth = np.full((HEIGHT, WIDTH), 1000 + number)
        depth[0, 0], depth[0, 1] = 0, 65535
        write_depth(stem.with_suffix(".depth.png"), depth)
        np.savetxt(stem.with_suffix(".pose.txt"), pose_at(number))
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[15, 0, 8], [0, 15, 6], [0, 0, 1]])
    np.savetxt(tmp_path / "gravity-direction.txt", [0.0, 0.0, -1.0])
    return tmp_path


def test_frames_come_in_number_order_with_gaps(folder: Path) -> None:
    capture = open_capture(folder)
    assert isinstance(capture, Capture)
    assert [frame.name for frame in capture] == ["frame-000002", "frame-000004", "frame-000010"]
    assert [frame.camera.origin[0] for frame in capture] == [2, 4, 10]
    assert capture[2].time == pytest.approx(8 / 30)
    assert capture[2].image[3, 3] == pytest.approx([0.1] * 3, abs=0.003)
    np.testing.assert_array_equal(capture.up, [0, 0, 1])


def test_depth_is_metres_and_both_markers_mean_no_reading(folder: Path) -> None:
    depth = open_capture(folder)[1].depth
    assert depth is not None
    assert depth[0, 0] == depth[0, 1] == 0
    assert depth[5, 5] == pytest.approx(1.004)


def test_pictures_are_read_when_asked_for(folder: Path) -> None:
    capture = open_capture(folder)
    damaged = folder / "frame-000010.color.png"
    damaged.write_bytes(damaged.read_bytes()[:40])
    assert capture[0].name == "frame-000002"
    with pytest.raises(InputError, match=r"frame-000010\.color\.png"):
        capture[2]


def test_truncated_depth_is_named(folder: Path) -> None:
    damaged = folder / "frame-000004.depth.png"
    damaged.write_bytes(damaged.read_bytes()[:60])
    refuses(folder, "frame-000004.depth.png")


def test_a_truncated_jpeg_is_left_out_with_a_line(folder: Path) -> None:
    damaged = folder / "frame-000004.color.jpg"
    picture = oiio.ImageBuf(oiio.ImageSpec(WIDTH, HEIGHT, 3, "uint8"))
    oiio.ImageBufAlgo.noise(picture, "uniform", 0.0, 1.0)
    picture.write(str(damaged))
    (folder / "frame-000004.color.png").unlink()
    assert len(list(open_capture(folder))) == 3
    damaged.write_bytes(damaged.read_bytes()[:-200])
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["frame-000002", "frame-000010"]
    assert capture.faults == ("1 of 3 pictures are damaged and left out (first: frame-000004.color.jpg)",)
    with pytest.raises(InputError, match=r"1 of 3 pictures are damaged .*--strict"):
        open_capture(folder, strict=True)


def test_up_is_estimated_without_gravity(folder: Path) -> None:
    (folder / "gravity-direction.txt").unlink()
    np.testing.assert_allclose(open_capture(folder).up, [0, -1, 0])


def test_gravity_must_be_a_unit_vector(folder: Path) -> None:
    np.savetxt(folder / "gravity-direction.txt", [0.0, 0.0, -9.81])
    refuses(folder, "gravity-direction.txt", "unit vector")


def test_capture_without_depth(folder: Path) -> None:
    for file in folder.glob("*.depth.png"):
        file.unlink()
    assert all(frame.depth is None for frame in open_capture(folder))


def test_a_missing_pose_leaves_its_picture_out_and_a_missing_depth_map_does_not(folder: Path) -> None:
    (folder / "frame-000004.pose.txt").unlink()
    (folder / "frame-000010.depth.png").unlink()
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["frame-000002", "frame-000010"]
    assert capture[0].depth is not None and capture[1].depth is None
    assert capture.faults == (
        "1 pictures have no pose and are left out (first: frame-000004.color.png)",
        "1 pictures have no depth map (first: frame-000010.color.png)",
    )


def test_a_capture_without_any_pose_is_refused(folder: Path) -> None:
    for file in folder.glob("*.pose.txt"):
        file.unlink()
    refuses(folder, "none of 3 pictures", "3 pictures have no pose")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("1 0 0 0\n0 1 0 0\n", "8 numbers"),
        ("1 0 0 0\n0 1 0 0\n0 0 one 0\n0 0 0 1\n", "plain numbers"),
        ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "rigid"),
        ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n", "determinant"),
        ("nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "finite"),
        ("", "0 numbers"),
    ],
)
def test_a_bad_pose_leaves_its_picture_out_with_a_line(folder: Path, content: str, problem: str) -> None:
    (folder / "frame-000010.pose.txt").write_text(content)
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["frame-000002", "frame-000004"]
    (line,) = capture.faults
    assert line.startswith("1 poses cannot be used, their pictures are left out (first: frame-000010.pose.txt: ")
    assert problem in line and str(folder) not in line
    with pytest.raises(InputError, match=r"frame-000010\.pose\.txt.*--strict"):
        open_capture(folder, strict=True)


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        ([[30, 0, 16], [0, 30, 12], [0, 0, 1]], "picture size"),
        ([[585, 0, 320], [0, 585, 240], [0, 0, 1]], "picture size"),
        ([[0, 0, 8], [0, 15, 6], [0, 0, 1]], "focal lengths"),
        ([[15, 0, 0], [0, 15, 0], [8, 6, 1]], "row by row"),
    ],
)
def test_intrinsics_that_do_not_fit(folder: Path, matrix: list[list[float]], problem: str) -> None:
    np.savetxt(folder / "camera-intrinsics.txt", matrix)
    refuses(folder, "camera-intrinsics.txt", problem)


def test_default_intrinsics_are_for_640x480_only(folder: Path) -> None:
    (folder / "camera-intrinsics.txt").unlink()
    refuses(folder, "camera-intrinsics.txt", "640x480", f"{WIDTH}x{HEIGHT}")
    for file in folder.glob("*.depth.png"):
        file.unlink()
    for file in folder.glob("*.color.png"):
        write_png(file, np.zeros((480, 640, 3)))
    capture = open_capture(folder)
    assert isinstance(capture, RegisteredKinect) and "585 585 320 240" in capture.remarks[0]


def test_depth_of_another_size(folder: Path) -> None:
    write_depth(folder / "frame-000004.depth.png", np.full((HEIGHT, WIDTH // 2), 1000))
    refuses(folder, "frame-000004", "8x12", "16x12")


def test_missing_and_empty_folders(tmp_path: Path) -> None:
    refuses(tmp_path / "nowhere", "nowhere", "no such folder")
    with pytest.raises(InputError, match="7-Scenes"):
        open_capture(tmp_path)


def test_kitchen(kitchen: Path) -> None:
    capture = open_capture(kitchen)
    assert len(capture) == 300
    last = capture[299]
    assert last.name == "frame-000598"
    assert last.depth is not None
    assert 0.5 < np.median(last.depth[last.depth > 0]) < 4
    # The cameras are held upright to within a hand's tilt.
    assert all(capture[i].camera.pose[:3, 1] @ capture.up < -0.8 for i in (0, 150, 299))
