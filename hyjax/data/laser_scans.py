"""The laser scans of an ARKitScenes venue → one `PointCloud`.

    laser_scanner_point_clouds/<visit id>/
        <id>.ply        one stand of the scanner: positions in its own axes, metres, with colours
        <id>_pose.txt   brings it into the venue's axes: three lines of a rotation, then a line of the translation

Source: Baruch et al., "ARKitScenes: a diverse real-world dataset for 3D indoor scene understanding using mobile
RGB-D data", NeurIPS Datasets and Benchmarks 2021.
"""

import hashlib
from pathlib import Path

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from hyjax.data.capture_files import fingerprint, read_numbers
from hyjax.geometry.camera import check_pose
from hyjax.geometry.ply import read_points
from hyjax.geometry.point_cloud import PointCloud, make_point_cloud
from hyjax.geometry.voxels import VoxelMean
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError

VERSION = 1
"""Of how clouds are made. Add one whenever one comes out differently."""


def load_laser_scans(folder: Path, voxel: float = 0.005, progress: bool = True) -> PointCloud:
    """All scans in a folder as one cloud in the venue's axes. Clouds are kept in the cache folder.

    Scans are read in pieces and thinned as they come: memory goes to the points that stay.

    Args:
        folder: of one venue.
        voxel: edge in metres of the cells that keep the mean of their points.
        progress: show bars on stderr.

    Raises:
        InputError: no such folder, no scan in it, a scan without its pose, a malformed pose, a scan that cannot be
            used (see `read_points`), an unusable voxel.
    """
    folder = Path(folder).resolve()
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of a venue's laser scans")
    scans = sorted(scan for scan in folder.glob("*.ply") if not scan.name.startswith("."))
    if not scans:
        raise InputError(f"{folder}: holds no laser scan <id>.ply; see --download_laser_scanner_point_cloud")
    poses = [_read_pose(scan.with_name(f"{scan.stem}_pose.txt")) for scan in scans]
    thinner = VoxelMean(voxel)
    key = hashlib.sha256(f"{VERSION} {voxel!r} {fingerprint(folder, [folder])}".encode()).hexdigest()[:16]
    file = cache_folder() / f"laser-{key}.npz"
    return cached_arrays(
        file, lambda arrays: PointCloud(**arrays), lambda: _make(folder, list(zip(scans, poses)), thinner, progress)
    )


def _make(folder: Path, scans: list[tuple[Path, np.ndarray]], thinner: VoxelMean, progress: bool) -> Arrays:
    for scan, pose in tqdm(scans, "laser scans", unit="scan", disable=not progress):
        for piece in read_points(scan):
            try:
                thinner.add(piece @ pose[:3, :3].T + pose[:3, 3])
            except InputError as error:
                raise InputError(f"{scan}: {error}") from error
    try:
        cloud = make_point_cloud(thinner.points(), progress=progress)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from error
    return {"points": cloud.points, "normals": cloud.normals, "radius": cloud.radius}


def _read_pose(path: Path) -> Float[np.ndarray, "4 4"]:
    if not path.is_file():
        raise InputError(f"{path}: missing; each laser scan needs its pose")
    numbers = read_numbers(path, (4, 3), "three lines of a rotation, then a line of the translation")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = numbers[:3], numbers[3]
    check_pose(pose, where=str(path))
    return pose
