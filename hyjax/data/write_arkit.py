"""Any capture written as a raw scan of ARKitScenes; see `hyjax.data.arkit_scenes` for the layout."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, Frame
from hyjax.data.recording import Z_UP
from hyjax.data.writers import Frames, turned_up, write_mesh
from hyjax.geometry.camera import Intrinsics
from hyjax.util.files import write_text
from hyjax.util.images import write_depth, write_labels, write_png

VIDEO = "10000000"
"""Number of the video in file names; that of no scan of the data set."""
FOLDERS = ("vga_wide", "vga_wide_intrinsics", "lowres_depth", "lowres_wide_intrinsics", "confidence")
STEP = 0.001
"""Seconds by which frames are apart at least: file names have three decimals."""


def fill_arkit(capture: Capture, frames: Frames, folder: Path) -> None:
    """A raw scan of ARKitScenes, the device's mesh included.

    The world is turned so that up is z. Depth keeps its size and lens, confidences become low, medium and high.
    Where some frames have depth, the others get a map without readings. Times are rounded to milliseconds;
    exposures and the anchors of lights are not kept.
    """
    turn = turned_up(capture.up, Z_UP)
    poses: list[tuple[str, Float[np.ndarray, "4 4"]]] = []
    last, has_depth = -STEP, False
    for _, frame in frames:
        last = max(round(frame.time, 3), round(last + STEP, 3))
        time = f"{last:.3f}"
        poses.append((time, turn @ frame.camera.pose))
        write_png(folder / f"vga_wide/{VIDEO}_{time}.png", frame.image)
        _write_lens(folder / f"vga_wide_intrinsics/{VIDEO}_{time}.pincam", frame.camera.intrinsics)
        has_depth |= frame.depth is not None
        _write_depth(folder, time, frame)
    if not has_depth:
        for path in (folder / "lowres_depth").iterdir():
            path.unlink()
    if len(poses) == 1:  # a trajectory has two at least
        poses.append((f"{last + 0.1:.3f}", poses[0][1]))
    write_text(folder / "lowres_wide.traj", "".join(_row(time, pose) for time, pose in poses))
    write_mesh(capture, folder / f"{VIDEO}_3dod_mesh.ply", turn)


def _row(time: str, pose: Float[np.ndarray, "4 4"]) -> str:
    """World to camera, as the layout has it."""
    motion = np.linalg.inv(pose)
    numbers = (*Rotation.from_matrix(motion[:3, :3]).as_rotvec(), *motion[:3, 3])
    return " ".join([time, *(repr(float(number)) for number in numbers)]) + "\n"


def _write_depth(folder: Path, time: str, frame: Frame) -> None:
    """A frame's depth map, or one without readings."""
    k = frame.depth_camera.intrinsics
    depth = np.zeros(k.shape, np.float32) if frame.depth is None else frame.depth
    write_depth(folder / f"lowres_depth/{VIDEO}_{time}.png", depth)
    _write_lens(folder / f"lowres_wide_intrinsics/{VIDEO}_{time}.pincam", k)
    if frame.depth is not None and frame.confidence is not None:
        levels = np.round(np.clip(frame.confidence, 0, 1) * 2).astype(np.uint8)
        write_labels(folder / f"confidence/{VIDEO}_{time}.png", levels)


def _write_lens(path: Path, k: Intrinsics) -> None:
    write_text(path, f"{k.width} {k.height} {k.fx!r} {k.fy!r} {k.cx!r} {k.cy!r}\n")
