"""transforms.json of nerfstudio, instant-ngp and Blender."""

import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_capture as small
from PIL import Image

from hyjax.data.registry import open_capture
from hyjax.util.errors import InputError

Content = dict[str, Any]
K = small.LENS
INTRINSICS = {"fl_x": K.fx, "fl_y": K.fy, "cx": K.cx, "cy": K.cy, "w": K.width, "h": K.height}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "office")


def write(folder: Path, with_depth: bool = True, ending: str = ".jpg") -> Path:
    frames = []
    for index in range(small.COUNT):
        small.save_picture(folder / f"images/frame_{index}{ending}", small.picture(index))
        entry: Content = {
            "file_path": f"images/frame_{index}{ending}",
            "transform_matrix": (small.pose(index) @ np.diag([1, -1, -1, 1])).tolist(),
        }
        if with_depth:
            small.save_depth(folder / f"depth/frame_{index}.png", small.depth(index))
            entry["depth_file_path"] = f"depth/frame_{index}.png"
        frames.append(entry)
    save(folder, {"camera_model": "OPENCV", **INTRINSICS, "frames": frames})
    return folder


def load(folder: Path) -> Content:
    return json.loads((folder / "transforms.json").read_text())


def save(folder: Path, content: Content) -> None:
    (folder / "transforms.json").write_text(json.dumps(content))


def change(folder: Path, **changes: object) -> None:
    save(folder, load(folder) | changes)


def test_a_folder_an_archive_and_the_file_itself_are_read_alike(folder: Path) -> None:
    for path in (folder, small.zipped(folder), folder / "transforms.json"):
        small.check_same(path)
    capture = open_capture(folder)
    assert capture.metric and [frame.name for frame in capture] == ["frame_0", "frame_1", "frame_2"]
    np.testing.assert_allclose(capture.up, [0, 0, 1])


def test_without_depth_the_unit_is_not_known(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write(tmp_path / "office", with_depth=False)
    with caplog.at_level(logging.WARNING):
        small.check_same(folder, has_depth=False)
    assert "its unit is not known" in caplog.text
    scaled = open_capture(folder, scale=2.0)
    np.testing.assert_allclose(scaled[1].camera.origin, 2 * small.pose(1)[:3, 3], atol=1e-6)


def test_depth_has_the_unit_that_the_file_tells_and_scales_with_the_poses(folder: Path) -> None:
    change(folder, depth_unit_scale_factor=0.0005)
    np.testing.assert_allclose(open_capture(folder)[0].depth, small.depth(0) / 2, atol=1e-6)
    np.testing.assert_allclose(open_capture(folder, scale=2.0)[0].depth, small.depth(0), atol=1e-6)
    change(folder, depth_unit_scale_factor=-1)
    with pytest.raises(InputError, match="depth_unit_scale_factor"):
        open_capture(folder)


def test_intrinsics_of_a_frame_come_before_those_of_the_file(folder: Path) -> None:
    content = load(folder)
    content["frames"][1] |= {"fl_x": 70.0, "cx": 30.0}
    save(folder, content)
    lenses = [frame.camera.intrinsics for frame in open_capture(folder)]
    assert [(k.fx, k.fy, k.cx) for k in lenses] == [(60, 58, 31), (70, 58, 30), (60, 58, 31)]


def test_blender_files_have_an_angle_of_view_and_names_without_extension(tmp_path: Path) -> None:
    folder = write(tmp_path / "lego", with_depth=False, ending=".png")
    frames = [
        {"file_path": f"./images/frame_{i}", "transform_matrix": entry["transform_matrix"]}
        for i, entry in enumerate(load(folder)["frames"])
    ]
    (folder / "transforms.json").unlink()
    (folder / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    for i in range(small.COUNT):
        image = Image.open(folder / f"images/frame_{i}.png").convert("RGBA")
        image.save(folder / f"images/frame_{i}.png")
    capture = open_capture(folder)
    k = capture[0].camera.intrinsics
    focal = 32 / math.tan(0.5)
    np.testing.assert_allclose([k.fx, k.fy, k.cx, k.cy], [focal, focal, 32, 24])
    assert capture[0].image.shape == (48, 64, 3) and np.allclose(capture.up, [0, 0, 1])
    assert any("transforms_train.json" in line for line in capture.remarks)


def test_paths_of_another_machine_are_found_by_their_ends(folder: Path) -> None:
    content = load(folder)
    for entry, start in zip(content["frames"], ("/home/ann/scans/office/", "C:\\scans\\office\\", "../office/")):
        entry["file_path"] = start + entry["file_path"]
        entry["depth_file_path"] = start + entry["depth_file_path"]
    content["frames"][1]["file_path"] = content["frames"][1]["file_path"].replace("/", "\\")
    save(folder, content)
    small.check_same(small.zipped(folder))


def test_listed_frames_whose_picture_is_missing_or_damaged_are_left_out_with_a_line(folder: Path) -> None:
    (folder / "images/frame_0.jpg").unlink()
    small.cut(folder / "images/frame_2.jpg")
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["frame_1"] and len(capture.faults) == 2
    assert "missing (first: images/frame_0.jpg)" in capture.faults[0] and "damaged" in capture.faults[1]
    with pytest.raises(InputError, match="strict"):
        open_capture(folder, strict=True)


def test_a_missing_depth_map_leaves_the_picture(folder: Path) -> None:
    (folder / "depth/frame_1.png").unlink()
    capture = open_capture(folder)
    assert len(capture) == 3 and capture.depth_count == 2 and capture[1].depth is None
    assert "depth maps are missing" in capture.faults[0]


def test_a_pose_that_is_nan_or_mirrored_is_left_out(folder: Path) -> None:
    content = load(folder)
    content["frames"][0]["transform_matrix"][0][3] = float("nan")
    content["frames"][1]["transform_matrix"] = np.diag([-1.0, 1, 1, 1]).tolist()
    save(folder, content)
    capture = open_capture(folder)
    assert len(capture) == 1 and "2 frames are left out, their poses" in capture.faults[0]


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_distortion_is_undone(folder: Path, model: str) -> None:
    change(folder, camera_model=model, k1=0.2, k2=0.01)
    image = open_capture(folder)[0].image
    change(folder, k1=0.0, k2=0.0, camera_model="OPENCV")
    plain = open_capture(folder)[0].image
    assert np.abs(image - plain).max() > 0.02
    # The pixel at the principal point stays where it is.
    np.testing.assert_allclose(image[24:26, 30:32], plain[24:26, 30:32], atol=0.01)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"k4": 0.1}, "k4"),
        ({"fl_x": "wide"}, "fl_x"),
        ({"fl_x": -60}, "focal"),
        ({"fl_x": None}, "fl_x"),
        ({"w": 1e400}, ": w:"),
        ({"h": -48}, "-48"),
        ({"frames": {}}, "frames"),
        ({"frames": [1]}, "frames"),
        ({"frames": [{"file_path": 3}]}, "file_path"),
        ({"frames": []}, "no frame"),
        ({"frames": [{"file_path": "images/frame_0.jpg"}]}, "transform_matrix"),
        ({"frames": [{"file_path": "images/frame_0.jpg", "transform_matrix": [[1, "2"]]}]}, "transform_matrix"),
        ({"up": [0, 0, 0]}, "up"),
    ],
)
def test_wrong_content_is_refused_with_the_name_of_the_key(folder: Path, changes: Content, told: str) -> None:
    change(folder, **changes)
    with pytest.raises(InputError, match=r"transforms\.json|office") as caught:
        open_capture(folder)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_up_is_what_the_file_tells_or_the_mean_of_the_cameras(tmp_path: Path) -> None:
    folder = write(tmp_path / "office", with_depth=False)
    mean = -np.mean([small.pose(i)[:3, 1] for i in range(small.COUNT)], axis=0)
    np.testing.assert_allclose(open_capture(folder).up, mean / np.linalg.norm(mean), atol=1e-6)
    change(folder, orientation_override="none")
    np.testing.assert_allclose(open_capture(folder).up, [0, 0, 1])
    change(folder, up=[0, 3, 4])
    np.testing.assert_allclose(open_capture(folder).up, [0, 0.6, 0.8])


def test_exposure_times_are_kept(folder: Path) -> None:
    content = load(folder)
    content["frames"][1]["exposure_time"] = 0.02
    save(folder, content)
    assert [frame.exposure for frame in open_capture(folder)] == [None, 0.02, None]


def test_a_point_cloud_beside_it_is_no_mesh(folder: Path) -> None:
    change(folder, ply_file_path="sparse_pc.ply")
    (folder / "sparse_pc.ply").write_text("ply\n")
    assert not open_capture(folder).has_mesh
