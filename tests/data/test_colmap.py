"""COLMAP's models, with a sensor's depth, with depth from pictures, or with none."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
import trimesh
from extras import need

from hyjax.data.colmap_files import read_array
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.mesh import save_mesh
from hyjax.util.errors import InputError

need("captures")
import pycolmap

K = small.LENS
PINHOLE = f"PINHOLE {K.width} {K.height} {K.fx} {K.fy} {K.cx} {K.cy}"
UNIT = 0.5
"""Metres in a unit of the model."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "hall")


def write(
    folder: Path, place: str = "sparse/0", camera: str = PINHOLE, binary: bool = True, names: str = ""
) -> Path:
    """A model whose points lie on the walls of the small capture's depth maps."""
    model = folder / place
    model.mkdir(parents=True, exist_ok=True)
    images, points = [], []
    for index in range(small.COUNT):
        to_camera = np.linalg.inv(small.pose(index))
        to_camera[:3, 3] /= UNIT
        rotation = pycolmap.Rotation3d(to_camera[:3, :3]).quat  # x y z w
        numbers = [rotation[3], *rotation[:3], *to_camera[:3, 3]]
        name = f"{names}{index}.jpg"
        small.save_picture(folder / "images" / name, small.picture(index))
        world = Camera(K, small.pose(index)).unproject(small.depth(index))
        seen = []
        for row in range(8, 48, 8):
            for column in range(8, 64, 8):
                number = len(points) + 1
                points.append(
                    f"{number} {' '.join(map(str, world[row, column] / UNIT))} 9 9 9 0.1 {index + 1} {len(seen)}"
                )
                seen.append(f"{column + 0.5} {row + 0.5} {number}")
        images += [f"{index + 1} {' '.join(map(repr, map(float, numbers)))} 1 {name}", " ".join(seen)]
    (model / "cameras.txt").write_text(f"# Camera list\n1 {camera}\n")
    (model / "images.txt").write_text("\n".join(images) + "\n")
    (model / "points3D.txt").write_text("\n".join(points) + "\n")
    if binary:
        pycolmap.Reconstruction(model).write_binary(model)
        for text in model.glob("*.txt"):
            text.unlink()
    return folder


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
@pytest.mark.parametrize("binary", [True, False])
def test_a_folder_and_an_archive_are_read_alike_wherever_the_model_is(
    tmp_path: Path, place: str, binary: bool, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write(tmp_path / "hall", place, binary=binary)
    for path in (folder, small.zipped(folder)):
        small.check_same(path, has_depth=False, scale=UNIT)
    capture = open_capture(folder)
    assert not capture.metric and "give --scale" in caplog.text
    np.testing.assert_allclose(capture[0].camera.origin, small.pose(0)[:3, 3] / UNIT, atol=1e-6)


def test_pictures_in_folders_that_share_names_are_told_apart(tmp_path: Path) -> None:
    folder = write(tmp_path / "hall", names="left/")
    assert [frame.name for frame in open_capture(folder)] == ["0", "1", "2"]


def test_unregistered_pictures_are_counted(folder: Path) -> None:
    for number in range(5):
        small.save_picture(folder / f"images/extra{number}.jpg", small.picture(0))
    assert any("5 of 8 pictures are not registered" in line for line in open_capture(folder).remarks)


def test_missing_and_damaged_pictures_are_left_out_with_lines(folder: Path) -> None:
    (folder / "images/0.jpg").unlink()
    small.cut(folder / "images/1.jpg")
    capture = open_capture(folder)
    assert [frame.name for frame in capture] == ["2"] and len(capture.faults) == 2


@pytest.mark.parametrize("name", ["depth", "depths"])
def test_a_sensors_depth_tells_the_scale(folder: Path, name: str) -> None:
    for index in range(small.COUNT):
        small.save_depth(folder / f"{name}/{index}.png", small.depth(index))
    mesh = trimesh.creation.box((2, 2, 2))
    (folder / "dense").mkdir()
    save_mesh(folder / "dense/meshed-poisson.ply", mesh)
    small.check_same(folder)
    capture = open_capture(folder)
    assert capture.metric and any("0.5 m in a unit" in line for line in capture.remarks)
    scaled = capture.mesh()
    assert scaled is not None
    np.testing.assert_allclose(scaled.extents, [1, 1, 1], atol=1e-5)


def test_damaged_depth_maps_leave_their_pictures(folder: Path) -> None:
    for index in range(small.COUNT):
        small.save_depth(folder / f"depth/{index}.png", small.depth(index))
    small.cut(folder / "depth/1.png")
    capture = open_capture(folder)
    assert len(capture) == 3 and capture.depth_count == 2 and capture.metric
    assert "1 depth maps are damaged" in capture.faults[0]


def test_a_given_scale_is_taken_instead_of_the_found_one(folder: Path) -> None:
    for index in range(small.COUNT):
        small.save_depth(folder / f"depth/{index}.png", small.depth(index))
    found, given = open_capture(folder), open_capture(folder, scale=3 * UNIT)
    np.testing.assert_allclose(given.camera(0).origin, 3 * found.camera(0).origin, rtol=0.01)
    np.testing.assert_array_equal(given.depth_reading(0).depth, found.depth_reading(0).depth)


def test_a_depth_map_that_is_damaged_within_does_not_hide_the_scale(folder: Path) -> None:
    for index in range(small.COUNT):
        small.save_depth(folder / f"depth/{index}.png", small.depth(index))
    small.save_picture(folder / "depth/1.png", small.picture(1))  # a picture where depth should be
    assert open_capture(folder).metric


def test_depth_maps_of_two_cameras_are_told_apart(tmp_path: Path) -> None:
    folder = write(tmp_path / "two", names="left/", binary=False)
    listing = folder / "sparse/0/images.txt"
    listing.write_text(listing.read_text().replace("left/1.jpg", "right/0.jpg"))
    (folder / "images/right").mkdir()
    (folder / "images/left/1.jpg").rename(folder / "images/right/0.jpg")
    small.save_depth(folder / "depth/0.png", small.depth(0))
    assert open_capture(folder).depth_count == 0  # which of the two it is of cannot be told
    small.save_depth(folder / "depth/right/0.png", small.depth(1))
    capture = open_capture(folder)
    assert capture.depth_count == 1 and [frame.name for frame in capture][-1] == "images_right_0.jpg"
    assert capture[2].depth is not None
    np.testing.assert_allclose(capture[2].depth, small.depth(1), atol=1e-6)


def test_depth_with_too_few_points_tells_no_scale(folder: Path) -> None:
    small.save_depth(folder / "depth/0.png", np.zeros(K.shape))
    capture = open_capture(folder)
    assert not capture.metric and any("too few" in line for line in capture.remarks)


def write_map(path: Path, depth: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = f"{depth.shape[1]}&{depth.shape[0]}&1&".encode()
    path.write_bytes(header + depth.astype("<f4").tobytes())


def test_depth_of_the_dense_reconstruction_is_in_units_of_the_model(folder: Path) -> None:
    shutil.copytree(folder, folder / "dense")
    for file in (folder / "dense/sparse/0").iterdir():
        file.rename(folder / "dense/sparse" / file.name)
    for index in range(small.COUNT):
        depth = small.depth(index) / UNIT
        depth[0, 0] = np.nan
        write_map(folder / f"dense/stereo/depth_maps/{index}.jpg.geometric.bin", depth)
    for path in (folder, folder / "dense", small.zipped(folder)):
        small.check_same(path, scale=UNIT)
    assert not open_capture(folder).metric


def test_a_damaged_depth_map_is_refused_by_name() -> None:
    for content in (b"", b"64&48&1&", b"64&48&3&xxxx", b"1&1&1&abc", b"a&b&c&", b"99999999&9&1&"):
        with pytest.raises(InputError, match=r"^map\.bin"):
            read_array(content, "map.bin")


@pytest.mark.parametrize(
    ("camera", "bends"),
    [
        ("SIMPLE_PINHOLE 64 48 60 31 25", False),
        ("SIMPLE_RADIAL 64 48 60 31 25 0.2", True),
        ("RADIAL 64 48 60 31 25 0.2 0.01", True),
        ("OPENCV 64 48 60 58 31 25 0.2 0 0.01 0.01", True),
        ("FULL_OPENCV 64 48 60 58 31 25 0.2 0 0 0 0 0 0 0.1", True),
        ("OPENCV_FISHEYE 64 48 60 58 31 25 0.1 0 0 0", True),
    ],
)
def test_lenses_that_are_known_are_undistorted(tmp_path: Path, camera: str, bends: bool) -> None:
    frame = open_capture(write(tmp_path / "hall", camera=camera))[0]
    assert frame.camera.intrinsics.fx == 60 and frame.camera.intrinsics.cx == 31
    assert (np.abs(frame.image - small.picture(0)).max() > 0.02) == bends


def test_other_lenses_are_refused_by_name(tmp_path: Path) -> None:
    folder = write(tmp_path / "hall", camera="FOV 64 48 60 58 31 25 0.9")
    with pytest.raises(InputError, match="camera model FOV is not read"):
        open_capture(folder)


def test_smaller_pictures_are_not_taken_for_the_models(folder: Path) -> None:
    (folder / "images").rename(folder / "images_4")
    with pytest.raises(InputError, match="images_4/ are smaller"):
        open_capture(folder)


def test_pictures_beside_a_transforms_json_belong_to_nerfstudio(folder: Path) -> None:
    (folder / "transforms.json").write_text("{}")
    with pytest.raises(InputError, match=r"transforms\.json: frames is missing"):
        open_capture(folder)


def test_without_pycolmap_one_line_says_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"needs the package pycolmap; .*\[captures\]"):
        open_capture(folder)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_a_file_that_is_cut_off_is_refused_by_name(folder: Path, name: str) -> None:
    for share in (0.5, 0.001):
        small.cut(folder / "sparse/0" / name, share)
        with pytest.raises(InputError, match=f"{name}: ends within|damaged model"):
            open_capture(folder)
