"""Any capture written as an ARKitScenes raw scan, with the names, digits, units and axes of Apple's own."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from hyjax.data.capture import Capture, Frame
from hyjax.data.orientation import turn_frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.mesh import save_mesh
from hyjax.util.images import write_png

START = 6845.21
"""What the device's clock says at the capture's start, seconds."""
POSE_SPACING = 0.1
"""Seconds between two poses of the trajectory, at most."""


def export_arkit_scan(
    folder: Path,
    capture: Capture,
    mesh: trimesh.Trimesh,
    *,
    video_id: str = "41000000",
    quarter_turns: int = 0,
    stride: int = 2,
) -> Path:
    """Write `capture` as the raw scan `folder`/`video_id`: pictures, intrinsics, depth, confidence, poses and mesh.

    No pose falls on a frame's time; interpolated to it, they give the frame's own. The `.pincam` of the second
    frame is named a millisecond late.

    Args:
        folder: made if need be.
        capture: frames at least 10 ms apart, depth (if any) registered to the pictures. Its world is turned so that
            `capture.up` becomes z.
        mesh: ARKit's mesh of it, in the capture's world.
        video_id: eight digits.
        quarter_turns: how the device is held: pictures on disk become upright by so many clockwise.
        stride: every so many pixels of the capture make lowres_wide and its depth.

    Returns:
        The scan's folder.
    """
    scan = folder / video_id
    frames = [capture[index] for index in range(len(capture))]
    times = [round(START + frame.time, 3) for frame in frames]
    for index, (time, frame) in enumerate(zip(times, frames)):
        name = f"{video_id}_{time:.3f}"
        late = f"{video_id}_{time + 0.001 * (index == 1):.3f}"
        vga, lowres = (turn_frame(f, -quarter_turns) for f in (frame, every(frame, stride)))
        write_png(file_in(scan / "vga_wide", f"{name}.png"), vga.image)
        write_pincam(file_in(scan / "vga_wide_intrinsics", f"{late}.pincam"), vga.camera.intrinsics)
        write_png(file_in(scan / "lowres_wide", f"{name}.png"), lowres.image)
        write_pincam(file_in(scan / "lowres_wide_intrinsics", f"{name}.pincam"), lowres.camera.intrinsics)
        if lowres.depth is not None:
            write_depth(file_in(scan / "lowres_depth", f"{name}.png"), 1000 * lowres.depth)
            confidence = np.where(lowres.depth > 0, 2, 0)
            write_png(file_in(scan / "confidence", f"{name}.png"), confidence / 255)
    z_up = np.eye(4)
    z_up[:3, :3] = Rotation.align_vectors([[0.0, 0.0, 1.0]], [capture.up])[0].as_matrix()
    poses = [z_up @ frame.camera.turned(-quarter_turns).pose for frame in frames]
    write_trajectory(scan / "lowres_wide.traj", np.array(times), np.array(poses))
    save_mesh(scan / f"{video_id}_3dod_mesh.ply", mesh.copy().apply_transform(z_up))
    return scan


def every(frame: Frame, stride: int) -> Frame:
    """The frame's every `stride`-th pixel in both directions, with its rays."""
    k = frame.camera.intrinsics
    image = frame.image[::stride, ::stride]
    cx, cy = (0.5 + (c - 0.5) / stride for c in (k.cx, k.cy))
    lens = Intrinsics(image.shape[1], image.shape[0], k.fx / stride, k.fy / stride, cx, cy)
    depth = None if frame.depth is None else frame.depth[::stride, ::stride]
    return dataclasses.replace(frame, image=image, camera=Camera(lens, frame.camera.pose), depth=depth)


def file_in(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


def write_pincam(path: Path, k: Intrinsics) -> None:
    path.write_text(f"{k.width} {k.height} {k.fx:.9g} {k.fy:.9g} {k.cx:.9g} {k.cy:.9g}\n")


def write_depth(path: Path, millimetres: Float[np.ndarray, "h w"]) -> None:
    """A 16-bit picture."""
    target = oiio.ImageOutput.create(str(path))
    target.open(str(path), oiio.ImageSpec(millimetres.shape[1], millimetres.shape[0], 1, "uint16"))
    target.write_image(np.ascontiguousarray(np.round(millimetres).astype(np.uint16)[..., None]))
    target.close()


def write_trajectory(path: Path, times: Float[np.ndarray, "n"], poses: Float[np.ndarray, "n 4 4"]) -> None:
    """Poses a little before and after each time, on an even motion through the pose then, and in between."""
    rotations, positions = Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]
    before, after = np.maximum(np.arange(len(times)) - 1, 0), np.minimum(np.arange(len(times)) + 1, len(times) - 1)
    seconds = np.maximum(times[after] - times[before], 1e-9)[:, None]
    turning = (rotations[after] * rotations[before].inv()).as_rotvec() / seconds
    moving = (positions[after] - positions[before]) / seconds
    reach = min(np.diff(times).min(initial=POSE_SPACING), POSE_SPACING)
    offsets = np.array([-0.3, 0.4]) * reach
    knots = (times[:, None] + offsets).ravel()
    turned = Rotation.concatenate(
        [Rotation.from_rotvec(w * s) * r for w, r in zip(turning, rotations) for s in offsets]
    )
    moved = np.concatenate([p + offsets[:, None] * v for p, v in zip(positions, moving)])
    pieces = [(a, b, int(np.ceil((b - a) / POSE_SPACING))) for a, b in pairwise(knots)]
    at = np.concatenate([np.linspace(*piece, endpoint=False) for piece in pieces] + [knots[-1:]])
    to_camera = Slerp(knots, turned)(at).inv()
    centres = np.stack([np.interp(at, knots, axis) for axis in moved.T], axis=-1)
    rows = zip(at, to_camera.as_rotvec(), -to_camera.apply(centres))
    path.write_text("".join(f"{t:.8f} {' '.join(f'{x:.10f}' for x in (*r, *p))}\n" for t, r, p in rows))
