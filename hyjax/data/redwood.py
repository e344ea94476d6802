"""Redwood's scenes and recordings made with Open3D: pictures, depth maps and a `.log` of poses, all by order.

    color/, image/ or rgb/      pictures
    depth/                      16-bit millimetres, registered to the pictures, PNG or PGM
    trajectory.log              five lines a frame: three numbers, then 4×4 camera-to-world, camera x right, y down,
                                z forward; also scene/trajectory.log, or the only .log there is
    camera_primesense.json      `width`, `height` and `intrinsic_matrix`, nine numbers column by column; also
                                camera_intrinsic.json, camera_intrinsics.json, intrinsic.json; optional
    scene/integrated.ply        mesh; optional

SLAMBench's dining room has the same layout but for its poses: `pose.txt`, a line `tx ty tz qx qy qz qw` a picture.

The number of a picture is its place among the files in order of the numbers in their names. Intrinsics count pixels
from the centre of the first one, hence half a pixel is added. Up is the cameras' mean up direction.

Tested on files written to the published layout, and on SLAMBench's dining room.

Sources: Choi, Zhou, Koltun, "Robust reconstruction of indoor scenes", CVPR 2015, and redwood-data.org's file
format; Open3D's documentation, "Reconstruction system" and `open3d.io.read_pinhole_camera_trajectory`.
"""

import functools
from pathlib import PurePosixPath

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import (
    Tally,
    by_number,
    intrinsics_at,
    looks_whole,
    short_names,
    tree_colour,
    tree_shape,
)
from hyjax.data.file_tree import FileTree
from hyjax.data.json_fields import Fields
from hyjax.data.posed_lists import floats, table_rows
from hyjax.data.recording import Recording, Shot, depth_reader, pose_from_quaternion, rigid
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.depth_sensor import KINECT
from hyjax.util.errors import InputError

PICTURES = ("color", "image", "rgb")
ENDINGS = (".jpg", ".jpeg", ".png")
DEPTH_ENDINGS = (".png", ".pgm")
QUATERNIONS = "pose.txt"
"""File of positions and quaternions, in the place of a log."""
INTRINSICS = ("camera_primesense.json", "camera_intrinsic.json", "camera_intrinsics.json", "intrinsic.json")
MESHES = ("scene/integrated.ply", "integrated.ply", "mesh.ply")
DEFAULT_INTRINSICS = Intrinsics(640, 480, 525.0, 525.0, 320.0, 240.0)
"""Open3D's `PrimeSenseDefault`, counted from the corner of the first pixel."""


def is_redwood(tree: FileTree) -> bool:
    """Whether there are `depth/`, a folder of pictures and a `.log` of poses, or `pose.txt`."""
    return _log_name(tree) is not None and _folder(tree) is not None and bool(_depth_names(tree))


def open_redwood(tree: FileTree) -> Recording:
    """Open a scene in the layout of Redwood or Open3D."""
    log, folder = _log_name(tree), _folder(tree)
    assert log is not None and folder is not None
    faults = Tally()
    remarks: list[str] = []
    pictures = sorted((n for e in ENDINGS for n in tree.below(folder, e)), key=by_number)
    depths = _by_picture(pictures, sorted(_depth_names(tree), key=by_number))
    poses = _read_rows(tree) if log == QUATERNIONS else _read_log(tree, log, len(pictures))
    if max(poses, default=0) >= len(pictures):
        missing = [number for number in poses if number >= len(pictures)]
        faults.add(f"poses of {log} are left out, there are {len(pictures)} pictures", f"pose {missing[0]}")
    if unposed := [name for number, name in enumerate(pictures) if number not in poses]:
        remarks.append(
            f"{len(unposed)} of {len(pictures)} pictures are left out, without pose (first: {unposed[0]})"
        )
    intrinsics = _intrinsics(tree, pictures[0], remarks)
    shots = []
    for number, (name, short) in enumerate(zip(pictures, short_names(pictures))):
        given = poses.get(number)
        pose = None if given is None else rigid(given)
        if number in poses and pose is None:
            faults.add(f"poses of {log} are left out, they are no rigid motions", f"pose {number}")
        elif pose is not None and not looks_whole(tree, name):
            faults.add("pictures are damaged and left out", name)
        elif pose is not None:
            depth = depths.get(name)
            if depth is None:
                faults.add("pictures have no depth map", name)
            elif not looks_whole(tree, depth):
                faults.add("depth maps are damaged and left out", depth)
                depth = None
            colour = functools.partial(tree_colour, tree, name)
            reader = None if depth is None else depth_reader(tree, depth)
            shots.append(Shot(short, number / 30, pose, intrinsics, colour, reader))
    mesh = next((name for name in MESHES if name in tree), None)
    return Recording(
        tree, shots, mesh=mesh, sensor=KINECT, faults=faults.lines(), remarks=remarks, times_known=False
    )


def _log_name(tree: FileTree) -> str | None:
    known = [name for name in ("trajectory.log", "scene/trajectory.log") if name in tree]
    logs = known[:1] or tree.below("", ".log") or [QUATERNIONS] * (QUATERNIONS in tree)
    return logs[0] if len(logs) == 1 else None


def _depth_names(tree: FileTree) -> list[str]:
    return next((names for ending in DEPTH_ENDINGS if (names := tree.below("depth", ending))), [])


def _folder(tree: FileTree) -> str | None:
    return next((f for f in PICTURES if any(tree.below(f, ending) for ending in ENDINGS)), None)


def _by_picture(pictures: list[str], depths: list[str]) -> dict[str, str]:
    """Depth map of each picture: of the same name where most have one, by order otherwise."""
    named = {PurePosixPath(depth).stem: depth for depth in depths}
    same = {picture: named[stem] for picture in pictures if (stem := PurePosixPath(picture).stem) in named}
    return same if 2 * len(same) > len(pictures) else dict(zip(pictures, depths))


def _read_log(tree: FileTree, name: str, count: int) -> dict[int, Float[np.ndarray, "4 4"] | None]:
    """Pose by number of the picture: the one that the log gives if these ascend, the place in the log otherwise."""
    where = tree.where(name)
    rows = [floats(words, where, row) for row, words in enumerate(table_rows(tree, name), start=1)]
    numbers, poses = [], []
    for start in range(0, len(rows), 5):
        head, *matrix = rows[start : start + 5]
        if len(head) != 3 or len(matrix) != 4 or any(len(row) != 4 for row in matrix):
            raise InputError(f"{where}: pose {start // 5} is not three numbers and four rows of four")
        numbers.append(head[0])
        poses.append(np.array(matrix))
    given = np.array(numbers)
    usable = bool(np.all(np.isfinite(given)) and np.all(given == np.round(given)) and np.all(np.diff(given) > 0))
    if len(given) and usable and given[0] >= 0 and given[-1] < count:
        return dict(zip(map(int, given), poses))
    return dict(enumerate(poses))


def _read_rows(tree: FileTree) -> dict[int, Float[np.ndarray, "4 4"] | None]:
    """Pose of each picture in order, from positions and quaternions; None for a row that is none."""
    where, poses = tree.where(QUATERNIONS), []
    for row, words in enumerate(table_rows(tree, QUATERNIONS), start=1):
        numbers = np.array(floats(words, where, row))
        if len(numbers) != 7:
            raise InputError(f"{where}: row {row} has {len(numbers)} numbers, need tx ty tz qx qy qz qw")
        poses.append(pose_from_quaternion(numbers[3:], numbers[:3]))
    return dict(enumerate(poses))


def _intrinsics(tree: FileTree, picture: str, remarks: list[str]) -> Intrinsics:
    height, width = tree_shape(tree, picture)
    name = next((name for name in INTRINSICS if name in tree), None)
    if name is None:
        if (height, width) != DEFAULT_INTRINSICS.shape:
            raise InputError(
                f"{tree.where(INTRINSICS[0])}: missing; the default is for 640x480, not {width}x{height}"
            )
        remarks.append(f"there is no {INTRINSICS[0]}; taking the PrimeSense's default, 525 525 319.5 239.5")
        return DEFAULT_INTRINSICS
    fields = Fields.of(tree, name)
    k = fields.numbers("intrinsic_matrix", 9).reshape(3, 3).T
    if not np.array_equal(k[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], (0, 0, 0, 0, 1)):
        raise InputError(
            f"{fields.where}: intrinsic_matrix: must be fx 0 0 0 fy 0 cx cy 1, got {k.T.ravel().tolist()}"
        )
    if "width" in fields and "height" in fields:
        height, width = fields.count("height"), fields.count("width")
    return intrinsics_at(fields.where, width, height, k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5)


FORMAT = CaptureFormat("Redwood", is_redwood, open_redwood, "color/, depth/, trajectory.log or pose.txt")
