"""7-Scenes and everything laid out like it: a folder of pictures, depth maps and poses with numbered names.

    frame-000012.color.jpg|png   sRGB
    frame-000012.depth.png       16-bit millimetres, 0 or 65535 where there is no reading
    frame-000012.pose.txt        4×4 camera-to-world, metres, +x right, +y down, +z forward
    camera-intrinsics.txt        3×3, shared by colour and depth
    gravity-direction.txt        unit vector of gravity in world coordinates; optional

Source: Shotton et al., "Scene coordinate regression forests for camera relocalization in RGB-D images",
CVPR 2013.
"""

import functools
import re

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import Tally, intrinsics_at, looks_whole, tree_colour, tree_numbers, tree_shape
from hyjax.data.file_tree import FileTree
from hyjax.data.kinect import KINECT, registered
from hyjax.data.recording import Recording, Shot, depth_reader
from hyjax.geometry.camera import Intrinsics, check_pose
from hyjax.util.errors import InputError

FRAME = re.compile(r"frame-(\d{1,15})\.color\.(?:jpe?g|png)")
FRAMES_PER_SECOND = 30.0


def is_seven_scenes(tree: FileTree) -> bool:
    """Whether there is at least one `frame-*.color.*` picture."""
    return any(FRAME.fullmatch(name) for name in tree.names)


def open_seven_scenes(tree: FileTree) -> Recording:
    """Open files in the 7-Scenes layout. Poses are read and checked now, pictures when asked for.

    Frames come in order of number. Gaps in the numbering are fine. Frames whose picture is damaged, or
    whose pose is damaged or missing, are left out.
    """
    colours = _numbered_colours(tree)
    has_depth = any(_companion(name, "depth.png") in tree for name in colours.values())
    faults = Tally()
    usable: dict[int, tuple[str, Float[np.ndarray, "4 4"]]] = {}
    for number, name in colours.items():
        if not looks_whole(tree, name):
            faults.add(f"of {len(colours)} pictures are damaged and left out", name)
        elif (pose := _read_pose(tree, name, faults)) is not None:
            usable[number] = name, pose
    if not usable:
        raise InputError(f"{tree.path}: none of {len(colours)} pictures can be used; {'; '.join(faults.lines())}")
    remarks: list[str] = []
    intrinsics = read_intrinsics(tree, tree_shape(tree, next(iter(usable.values()))[0]), remarks)
    shots = []
    for number, (name, pose) in usable.items():
        depth = _companion(name, "depth.png")
        if has_depth and depth not in tree:
            faults.add("pictures have no depth map", name)
        shots.append(
            Shot(
                f"frame-{number:06d}",
                number / FRAMES_PER_SECOND,
                pose,
                intrinsics,
                functools.partial(tree_colour, tree, name),
                depth_reader(tree, depth) if depth in tree else None,
                depth_intrinsics=intrinsics,
            )
        )
    up, told = read_up(tree), faults.lines()
    return Recording(tree, shots, up=up, faults=told, remarks=remarks, turn=False, times_known=False)


def _numbered_colours(tree: FileTree) -> dict[int, str]:
    """Frame number → name of the colour picture, in number order."""
    found: dict[int, str] = {}
    for name in tree.below(""):
        if match := FRAME.fullmatch(name):
            number = int(match[1])
            if number in found:
                raise InputError(f"{tree.where(name)}: frame {number} is also {found[number]}; keep one of the two")
            found[number] = name
    return dict(sorted(found.items()))


def _companion(colour: str, suffix: str) -> str:
    return f"{colour.split('.')[0]}.{suffix}"


def _read_pose(tree: FileTree, colour: str, faults: Tally) -> Float[np.ndarray, "4 4"] | None:
    """Pose of a picture; None, with a fault, if there is none."""
    name = _companion(colour, "pose.txt")
    if name not in tree:
        faults.add("pictures have no pose and are left out", colour)
        return None
    try:
        pose = tree_numbers(tree, name, (4, 4))
        check_pose(pose, where=tree.where(name))
    except InputError as error:
        reason = str(error).removeprefix(f"{tree.where(name)}: ")
        faults.add("poses cannot be used, their pictures are left out", f"{name}: {reason}")
        return None
    return pose


def read_intrinsics(tree: FileTree, shape: tuple[int, ...], remarks: list[str]) -> Intrinsics:
    """Intrinsics of all pictures, which have this shape, with a remark if they are the default ones."""
    height, width = shape
    name = "camera-intrinsics.txt"
    path = tree.where(name)
    if name not in tree:
        if (height, width) != KINECT.shape:
            raise InputError(
                f"{path}: missing; the 7-Scenes default is for 640x480 pictures, these are {width}x{height}"
            )
        remarks.append(f"there is no {name}; taking those of the 7-Scenes Kinect, 585 585 320 240")
        return KINECT
    k = tree_numbers(tree, name, (3, 3))
    if not np.allclose(k[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], (0, 0, 0, 0, 1)):
        raise InputError(f"{path}: need fx 0 cx / 0 fy cy / 0 0 1 row by row (no skew), got {k.tolist()}")
    intrinsics = intrinsics_at(path, width, height, *k[[0, 1, 0, 1], [0, 1, 2, 2]])
    # Intrinsics of another picture size betray themselves by their principal point.
    if not (0.25 < intrinsics.cx / width < 0.75 and 0.25 < intrinsics.cy / height < 0.75):
        raise InputError(
            f"{path}: principal point ({intrinsics.cx:g}, {intrinsics.cy:g}) is far from the centre of the "
            f"{width}x{height} pictures; give the intrinsics of this picture size"
        )
    return intrinsics


def read_up(tree: FileTree) -> Float[np.ndarray, "3"] | None:
    """Unit vector against gravity from its file; None without one."""
    name = "gravity-direction.txt"
    if name not in tree:
        return None
    up = -tree_numbers(tree, name, (3,))
    if not abs(np.linalg.norm(up) - 1.0) < 0.01:
        raise InputError(f"{tree.where(name)}: need a unit vector, this one is {np.linalg.norm(up):.3g} long")
    return up / np.linalg.norm(up)


FORMAT = CaptureFormat(
    "7-Scenes",
    is_seven_scenes,
    lambda tree: registered(open_seven_scenes(tree)),
    "frame-NNNNNN.color.jpg|png",
)
