"""Any capture written as 7-Scenes or nerfstudio's; see `hyjax.data.seven_scenes` and `hyjax.data.nerfstudio`.

The device's mesh, for which neither layout has a place, is written beside as `mesh.ply`. Dates and places are not
in a `Capture`, so they reach no file.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, Frame
from hyjax.data.recording import from_opengl
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.mesh import save_mesh
from hyjax.util.files import write_text
from hyjax.util.images import write_depth, write_png

MESH = "mesh.ply"
Frames = Iterator[tuple[int, Frame]]
"""Frames to write, and their numbers from 0 on."""


def fill_7scenes(capture: Capture, frames: Frames, folder: Path) -> None:
    """7-Scenes: pictures as PNG, depth registered to them, one lens for all.

    Pictures of another lens than the first frame's are sampled anew; so is depth that is not registered. Where some
    frames have depth, the others get a map without readings. Depth of no confidence is left out, as this layout has
    no place for confidences. Times, exposures and the anchors of lights are not kept.
    """
    lens: Intrinsics | None = None
    without: list[str] = []
    count = 0
    for number, frame in frames:
        lens, count = lens or frame.camera.intrinsics, number + 1
        name = f"frame-{number:06d}"
        image = seen_through(frame.image, frame.camera.intrinsics, lens)
        write_png(folder / f"{name}.color.png", image)
        write_text(folder / f"{name}.pose.txt", rows(frame.camera.pose))
        if frame.depth is None:
            without.append(name)
        else:
            write_depth(folder / f"{name}.depth.png", registered_depth(frame, lens))
    assert lens is not None  # of the first frame
    if len(without) < count:
        for name in without:
            write_depth(folder / f"{name}.depth.png", np.zeros(lens.shape, np.float32))
    write_text(folder / "camera-intrinsics.txt", rows(lens.matrix))
    write_text(folder / "gravity-direction.txt", rows(-np.asarray(capture.up)[None]))
    write_mesh(capture, folder / MESH)


def fill_nerfstudio(capture: Capture, frames: Frames, folder: Path) -> None:
    """nerfstudio: `transforms.json`, pictures as PNG, depth in millimetres.

    Every frame has its own intrinsics. Depth keeps its size, but is sampled anew where its lens is not the
    picture's; of no confidence it is left out, as this layout has no place for confidences. Times and the anchors
    of lights are not kept.
    """
    entries = []
    for number, frame in frames:
        k = frame.camera.intrinsics
        picture = f"images/frame_{number:06d}.png"
        write_png(folder / picture, frame.image)
        entry: dict[str, Any] = {
            "file_path": picture,
            "transform_matrix": from_opengl(frame.camera.pose).tolist(),
        }
        entry |= {"fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy, "w": k.width, "h": k.height}
        if frame.depth is not None:
            entry["depth_file_path"] = f"depth/frame_{number:06d}.png"
            lens = k.resize(*frame.depth.shape)
            write_depth(folder / entry["depth_file_path"], registered_depth(frame, lens))
        if frame.exposure is not None:
            entry["exposure_time"] = frame.exposure
        entries.append(entry)
    content = {
        "camera_model": "OPENCV",
        "depth_unit_scale_factor": 0.001,
        "up": np.asarray(capture.up, np.float64).tolist(),
        "frames": entries,
    }
    write_text(folder / "transforms.json", json.dumps(content, indent=1) + "\n")
    write_mesh(capture, folder / MESH)


def turned_up(up: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """The rotation of the world, by the least angle, after which `up` is an axis."""
    turn = np.eye(4)
    if not np.allclose(up, axis, atol=1e-9):
        turn[:3, :3] = Rotation.align_vectors([axis], [up])[0].as_matrix()
    return turn


def rows(numbers: Float[np.ndarray, "h w"]) -> str:
    """A matrix as text, a line a row, each number with all its digits."""
    return "".join(" ".join(repr(float(number)) for number in row) + "\n" for row in numbers)


def write_mesh(capture: Capture, path: Path, turn: Float[np.ndarray, "4 4"] | None = None) -> None:
    """Write the mesh that the device made, if there is one, turned as the world is."""
    mesh = capture.mesh()
    if mesh is not None:
        save_mesh(path, mesh if turn is None else mesh.copy().apply_transform(turn))


def registered_depth(frame: Frame, lens: Intrinsics) -> Float[np.ndarray, "h w"]:
    """A frame's depth as a lens at the same place sees it, without readings of no confidence."""
    assert frame.depth is not None
    depth = frame.depth if frame.confidence is None else np.where(frame.confidence > 0, frame.depth, np.float32(0))
    return seen_through(depth, frame.depth_camera.intrinsics, lens, nearest=True)


def seen_through(
    pixels: Float[np.ndarray, "h w *c"], source: Intrinsics, target: Intrinsics, *, nearest: bool = False
) -> Float[np.ndarray, "h2 w2 *c"]:
    """Pixels of one lens as another at the same place sees them.

    Args:
        nearest: take the nearest pixel, as depth wants it, and 0 beyond the borders; otherwise pixels are mixed,
            and the nearest goes on beyond the borders.
    """
    if _alike(source, target):
        return pixels
    x = (np.arange(target.width) + 0.5 - target.cx) / target.fx * source.fx + source.cx
    y = (np.arange(target.height) + 0.5 - target.cy) / target.fy * source.fy + source.cy
    if nearest:
        inside = ((y >= 0) & (y < source.height))[:, None] & ((x >= 0) & (x < source.width))[None, :]
        row = np.clip(np.floor(y), 0, source.height - 1).astype(int)
        column = np.clip(np.floor(x), 0, source.width - 1).astype(int)
        return np.where(inside, pixels[np.ix_(row, column)], pixels.dtype.type(0))
    where = np.stack(np.broadcast_arrays(y[:, None] - 0.5, x[None, :] - 0.5))
    layers = [
        ndimage.map_coordinates(layer, where, order=1, mode="nearest") for layer in np.moveaxis(pixels, -1, 0)
    ]
    return np.stack(layers, -1).astype(pixels.dtype)


def _alike(source: Intrinsics, target: Intrinsics) -> bool:
    """Whether two lenses see the same to within a hundredth of a pixel."""
    if source.shape != target.shape:
        return False
    one, other = (np.array([k.fx, k.fy, k.cx, k.cy]) for k in (source, target))
    return bool(np.abs(one - other).max() < 0.01)
