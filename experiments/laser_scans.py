"""Laser scans of an ARKitScenes venue as one mesh of discs.

    laser_scanner_point_clouds/<visit id>/
        <id>.ply        one stand of the scanner: positions in its own axes, metres, with colours
        <id>_pose.txt   brings it into the venue's axes: three lines of a rotation, then a line of the translation

Source: Baruch et al., "ARKitScenes: a diverse real-world dataset for 3D indoor scene understanding using mobile
RGB-D data", NeurIPS Datasets and Benchmarks 2021.
"""

import re
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from tqdm import tqdm

from hyjax.data.capture_files import tree_numbers
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import check_pose
from hyjax.geometry.point_cloud import disc_mesh, thinned
from hyjax.util.errors import InputError


def load_laser_scans(folder: Path, voxel: float = 0.005, progress: bool = True) -> trimesh.Trimesh:
    """All scans in a folder, in the venue's axes, thinned to a point in each cell of `voxel` metres.

    Raises:
        InputError: no scan in it, a scan without its pose, a malformed pose, a scan that cannot be used.
    """
    scans = sorted(scan for scan in folder.glob("*.ply") if not scan.name.startswith("."))
    if not scans:
        raise InputError(f"{folder}: holds no laser scan <id>.ply; see --download_laser_scanner_point_cloud")
    poses = [_read_pose(scan.with_name(f"{scan.stem}_pose.txt")) for scan in scans]
    pieces = []
    for scan, pose in tqdm(list(zip(scans, poses)), "laser scans", unit="scan", disable=not progress):
        try:
            pieces.append(thinned(load_points(scan) @ pose[:3, :3].T + pose[:3, 3], voxel))
        except InputError as error:
            raise InputError(f"{scan}: {error}") from error
    return disc_mesh(np.concatenate(pieces), voxel, progress)


def load_points(path: Path) -> Float[np.ndarray, "n 3"]:
    """Positions in a PLY file.

    Raises:
        InputError: it cannot be read, or was cut off.
    """
    try:
        points = np.asarray(trimesh.load(path, process=False).vertices)
        announced = int(re.findall(rb"element vertex (\d+)", path.read_bytes()[:65536])[0])
    except Exception as error:  # trimesh fails in many ways
        raise InputError(f"cannot be read as points, damaged or truncated? ({error})") from None
    if len(points) < announced or not np.isfinite(points).all():
        raise InputError(f"truncated, has {len(points)} of {announced} vertices, or some that are not finite")
    return points


def _read_pose(path: Path) -> Float[np.ndarray, "4 4"]:
    if not path.is_file():
        raise InputError(f"{path}: missing; each laser scan needs its pose")
    numbers = tree_numbers(
        open_tree(path), path.name, (4, 3), "three lines of a rotation, then a line of the translation"
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = numbers[:3], numbers[3]
    check_pose(pose, where=str(path))
    return pose
