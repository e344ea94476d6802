"""A small capture to be written in every layout: three posed pictures with depth, and its folder as a ZIP."""

import zipfile
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Intrinsics, look_at

LENS = Intrinsics(64, 48, 60.0, 58.0, 31.0, 25.0)
UP = np.array([0.0, 0.0, 1.0])
COUNT = 3


def pose(index: int) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world; z is up."""
    return look_at(np.array([1.0 + 0.25 * index, -0.5, 1.5]), np.array([3.0, 2.0 + 0.5 * index, 1.25]), UP)


def picture(index: int, lens: Intrinsics = LENS) -> Float[np.ndarray, "h w 3"]:
    """Slopes of colour, in whole steps of 255."""
    y, x = np.mgrid[: lens.height, : lens.width]
    layers = [x / lens.width, y / lens.height, np.full(lens.shape, 0.2 + 0.2 * index)]
    return (np.round(np.stack(layers, -1) * 255) / 255).astype(np.float32)


def depth(index: int, lens: Intrinsics = LENS) -> Float[np.ndarray, "h w"]:
    """A slanted wall in whole millimetres, with a corner that has no reading."""
    y, x = np.mgrid[: lens.height, : lens.width]
    metres = np.round(2.0 + 0.25 * index + 0.5 * x / lens.width + 0.25 * y / lens.height, 3)
    metres[:4, :6] = 0
    return metres.astype(np.float32)


def save_picture(path: Path, image: Float[np.ndarray, "h w 3"]) -> None:
    """A PNG or JPEG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(image * 255).astype(np.uint8)).save(path, quality=98, subsampling=0)


def save_depth(path: Path, metres: Float[np.ndarray, "h w"], steps: float = 1000.0) -> None:
    """A 16-bit PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(metres.astype(np.float64) * steps).astype(np.uint16)).save(path)


def zipped(folder: Path) -> Path:
    """The folder in an archive beside it, under its own name."""
    archive = folder.with_suffix(".zip")
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                file.write(path, f"{folder.name}/{path.relative_to(folder)}")
    return archive


def cut(path: Path, share: float = 0.5) -> None:
    """Cut a file off."""
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])


def check_same(path: Path, *, has_depth: bool = True, tolerance: float = 0.02, scale: float | None = None) -> None:
    """The small capture is what lies at a path: poses, lens, pictures, depth."""
    capture = open_capture(path, scale=scale)
    assert len(capture) == COUNT and not capture.faults
    for index, frame in enumerate(capture):
        np.testing.assert_allclose(frame.camera.pose, pose(index), atol=1e-6)
        k = frame.camera.intrinsics
        np.testing.assert_allclose([k.fx, k.fy, k.cx, k.cy], [LENS.fx, LENS.fy, LENS.cx, LENS.cy], atol=1e-4)
        np.testing.assert_allclose(frame.image, picture(index), atol=tolerance)
        if has_depth:
            assert frame.depth is not None
            np.testing.assert_allclose(frame.depth, depth(index), atol=1e-6)
    assert capture.depth_count == (COUNT if has_depth else 0)
