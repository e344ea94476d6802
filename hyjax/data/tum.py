"""TUM RGB-D and everything laid out like it (ICL-NUIM, recordings made for ORB-SLAM).

    rgb.txt, depth.txt    `timestamp file`, seconds; lines with # are comments
    groundtruth.txt       `timestamp tx ty tz qx qy qz qw`, camera-to-world, camera x right, y down, z forward
    rgb/, depth/          pictures, and 16-bit depth maps of 5000 steps a metre
    camera.txt            `fx fy cx cy`, then k1 k2 p1 p2 k3 if the lens is known; or 3×3; optional, not of TUM

The three clocks differ: a picture's depth map is the nearest within 20 ms, its pose is interpolated. Depth is
registered to the pictures as the lens gave them, so both are undistorted. Intrinsics are the published ones of the
freiburg1, 2 or 3 in the folder's name; these count pixels from the centre of the first one, hence half a pixel is
added. Frames are called by their place in rgb.txt, as their times tell the date. World z is up in TUM's own
sequences, whose poses are a motion capture system's; elsewhere it is the cameras' mean up direction.

Tested on files written to the published layout, not on a real capture.

Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012; file formats and intrinsics
of cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

import functools
import re

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import Tally, TimedFile, TimedFiles, looks_whole, tree_colour, tree_shape
from hyjax.data.file_tree import FileTree
from hyjax.data.lens import Distortion
from hyjax.data.posed_lists import ascending, floats, table_rows
from hyjax.data.recording import Z_UP, Recording, Shot, depth_reader, pose_from_quaternion
from hyjax.data.trajectory import Trajectory
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

TOLERANCE = 0.02
"""Seconds between a picture and its depth map."""
DEPTH_UNIT = 1 / 5000
CAMERAS = ("camera.txt", "calibration.txt")
DEFAULT_INTRINSICS = (525.0, 525.0, 319.5, 239.5)
"""Intrinsics of the Kinect's driver, for 640×480."""
PUBLISHED_INTRINSICS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""fx fy cx cy k1 k2 p1 p2 k3 of the colour cameras, for 640×480; the third's pictures are undistorted already."""


def is_tum(tree: FileTree) -> bool:
    """Whether there are `rgb.txt` and `groundtruth.txt`."""
    return "rgb.txt" in tree and "groundtruth.txt" in tree


def open_tum(tree: FileTree) -> Recording:
    """Open a sequence in TUM's layout."""
    faults = Tally()
    remarks: list[str] = []
    trajectory = _trajectory(tree, faults)
    pictures = _listed(tree, "rgb.txt", faults)
    depths = TimedFiles(_listed(tree, "depth.txt", faults) if "depth.txt" in tree else ())
    if not pictures:
        raise InputError(f"{tree.where('rgb.txt')}: none of its pictures can be read; {'; '.join(faults.lines())}")
    covered = [picture for picture in pictures if trajectory.covers(picture.time)]
    if not covered:
        raise InputError(
            f"{tree.path}: no picture has a pose: rgb.txt runs from {pictures[0].time:.3f} to "
            f"{pictures[-1].time:.3f} s, groundtruth.txt from {trajectory.times[0]:.3f} to "
            f"{trajectory.times[-1]:.3f} s"
        )
    if uncovered := len(pictures) - len(covered):
        remarks.append(f"{uncovered} of {len(pictures)} pictures are left out, groundtruth.txt does not cover them")
    intrinsics, distortion = _camera(tree, covered[0].name, remarks)
    shots = []
    for number, picture in enumerate(pictures):
        if not trajectory.covers(picture.time):
            continue
        depth = depths.nearest(picture.time, TOLERANCE)
        shots.append(
            Shot(
                f"{number:06d}",
                picture.time,
                trajectory.pose_at(picture.time),
                intrinsics,
                functools.partial(tree_colour, tree, picture.name),
                None if depth is None else depth_reader(tree, depth.name, DEPTH_UNIT),
                distortion=distortion,
                depth_distortion=distortion,
            )
        )
    lone = [shot.name for shot in shots if shot.depth is None]
    if len(depths) and lone:
        remarks.append(f"{len(lone)} of {len(shots)} pictures have no depth map within 20 ms (first: {lone[0]})")
    up = Z_UP if _sequence(tree) else None
    return Recording(tree, shots, up=up, sensor=KINECT, faults=faults.lines(), remarks=remarks)


def _listed(tree: FileTree, name: str, faults: Tally) -> list[TimedFile]:
    """The files that a list names and that are there, in order of time."""
    where, found = tree.where(name), []
    for row, words in enumerate(table_rows(tree, name), start=1):
        if len(words) < 2:
            raise InputError(f"{where}: row {row} is not 'timestamp file': {' '.join(words)[:60]!r}")
        found.append(TimedFile(floats(words[:1], where, row)[0], words[1].removeprefix("./")))
    kept = ascending(np.array([entry.time for entry in found]))
    for row in sorted(set(range(len(found))) - set(kept)):
        faults.add(f"rows of {name} are left out, their time is not after the row above", f"row {row + 1}")
    whole = []
    for entry in (found[row] for row in kept):
        if entry.name not in tree:
            faults.add(f"files of {name} are missing", entry.name)
        elif not looks_whole(tree, entry.name):
            faults.add(f"files of {name} are damaged and left out", entry.name)
        else:
            whole.append(entry)
    return whole


def _trajectory(tree: FileTree, faults: Tally) -> Trajectory:
    name = "groundtruth.txt"
    where = tree.where(name)
    times, poses = [], []
    for row, words in enumerate(table_rows(tree, name), start=1):
        numbers = np.array(floats(words, where, row))
        if len(numbers) != 8:
            raise InputError(f"{where}: row {row} has {len(numbers)} numbers, need timestamp tx ty tz qx qy qz qw")
        pose = pose_from_quaternion(numbers[4:], numbers[1:4])
        if pose is None or not np.isfinite(numbers[0]):
            faults.add(f"rows of {name} are left out, they are no poses", f"row {row}")
            continue
        times.append(numbers[0])
        poses.append(pose)
    kept = ascending(np.array(times))
    for row in sorted(set(range(len(times))) - set(kept)):
        faults.add(f"rows of {name} are left out, their time is not after the row above", f"pose {row + 1}")
    if len(kept) < 2:
        raise InputError(f"{where}: has {len(kept)} pose(s) in order of time, need at least two")
    return Trajectory(np.array(times)[kept], np.array(poses)[kept], where)


def _sequence(tree: FileTree) -> str | None:
    """TUM's camera, by the folder's name."""
    match = re.search(r"freiburg[123]|(?<![a-z0-9])fr[123](?![0-9])", tree.path.resolve().name.lower())
    return None if match is None else f"freiburg{match[0][-1]}"


def _camera(tree: FileTree, picture: str, remarks: list[str]) -> tuple[Intrinsics, Distortion | None]:
    height, width = tree_shape(tree, picture)
    name = next((name for name in CAMERAS if name in tree), None)
    values: Float[np.ndarray, n] = np.array(PUBLISHED_INTRINSICS.get(_sequence(tree) or "", DEFAULT_INTRINSICS))
    if name is not None:
        values = _written(tree, name)
    elif (height, width) != (480, 640):
        raise InputError(
            f"{tree.where(CAMERAS[0])}: missing; the published intrinsics are for 640x480, the pictures are "
            f"{width}x{height}; write fx fy cx cy there"
        )
    elif _sequence(tree) is None:
        remarks.append(
            f"intrinsics are not given, taking {' '.join(f'{v:g}' for v in DEFAULT_INTRINSICS)}; see {CAMERAS[0]}"
        )
    fx, fy, cx, cy = (float(value) for value in values[:4])
    k1, k2, p1, p2, k3 = (float(value) for value in (*values[4:], *np.zeros(9 - len(values))))
    try:
        intrinsics = Intrinsics(width, height, fx, fy, cx + 0.5, cy + 0.5)
        distortion = Distortion("brown", (k1, k2, k3), (p1, p2))
    except InputError as error:
        raise InputError(f"{tree.where(name or '')}: {error}") from None
    return intrinsics, None if distortion.is_none else distortion


def _written(tree: FileTree, name: str) -> Float[np.ndarray, "n"]:
    """fx fy cx cy, with k1 k2 p1 p2 k3 if they are there."""
    where = tree.where(name)
    rows = table_rows(tree, name)
    values = np.array(floats([word for words in rows for word in words], where, 1))
    if len(values) == 9 and np.array_equal(values[[1, 3, 6, 7, 8]], (0, 0, 0, 0, 1)):
        return values[[0, 4, 2, 5]]
    if len(values) not in (4, 8, 9):
        raise InputError(f"{where}: has {len(values)} numbers, need fx fy cx cy, then k1 k2 p1 p2 k3 if known")
    return values


FORMAT = CaptureFormat("TUM RGB-D", is_tum, open_tum, "rgb.txt, depth.txt, groundtruth.txt")
