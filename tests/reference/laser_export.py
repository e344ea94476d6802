"""Laser scans of a mesh, written as the Faro scans of ARKitScenes are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Float

from hyjax.geometry.raycast import RayCaster

Kind = Literal["ascii", "binary_little_endian", "binary_big_endian"]
POINT = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
NAMES = {"f4": "float", "u1": "uchar"}


def export_laser_scans(
    folder: Path,
    mesh: trimesh.Trimesh,
    poses: Sequence[Float[np.ndarray, "4 4"]],
    points_per_scan: int,
    kind: Kind = "binary_little_endian",
) -> None:
    """Write `<id>.ply` and `<id>_pose.txt` for a scanner at each pose (scanner to world).

    Points are spread evenly over the mesh; of `points_per_scan` tried, those that the scanner sees are written.
    """
    caster = RayCaster(mesh)
    for number, pose in enumerate(poses):
        points, _ = trimesh.sample.sample_surface(mesh, points_per_scan, seed=number)
        # The last millimetre in a metre belongs to the surface itself.
        seen = ~caster.occluded(pose[None, :3, 3], points - pose[:3, 3], 0.999)
        local = (points[seen] - pose[:3, 3]) @ pose[:3, :3]
        write_point_ply(folder / f"{468000 + number}.ply", local, kind)
        np.savetxt(folder / f"{468000 + number}_pose.txt", np.r_[pose[:3, :3], pose[None, :3, 3]], fmt="%.12f")


def write_point_ply(path: Path, points: Float[np.ndarray, "n 3"], kind: Kind) -> None:
    """Positions with grey colours."""
    rows = np.full(len(points), 128, dtype=POINT)
    rows["x"], rows["y"], rows["z"] = points.T
    properties = "".join(f"property {NAMES[kind_]} {name}\n" for name, kind_ in POINT)
    header = f"ply\nformat {kind} 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    with path.open("wb") as file:
        file.write(header.encode())
        if kind == "ascii":
            np.savetxt(file, rows, fmt=["%.9g"] * 3 + ["%d"] * 3)
        else:
            order = "<" if kind == "binary_little_endian" else ">"
            rows.astype(rows.dtype.newbyteorder(order)).tofile(file)
