"""7-Scenes and everything laid out like it: a folder of pictures, depth maps and poses with numbered names.

    frame-000012.color.jpg|png   sRGB
    frame-000012.depth.png       16-bit millimetres, 0 or 65535 where there is no reading
    frame-000012.pose.txt        4×4 camera-to-world, metres, +x right, +y down, +z forward
    camera-intrinsics.txt        3×3, shared by colour and depth
    gravity-direction.txt        unit vector of gravity in world coordinates; optional

Source: Shotton et al., "Scene coordinate regression forests for camera relocalization in RGB-D images",
CVPR 2013.
"""

import logging
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture, CaptureFormat, Frame
from hyjax.data.capture_files import looks_whole, tree_colour, tree_depth, tree_numbers
from hyjax.data.file_tree import FileTree
from hyjax.data.kinect import KINECT, registered
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Camera, Intrinsics, check_pose
from hyjax.geometry.depth_map import DepthReading
from hyjax.util.errors import InputError
from hyjax.util.images import picture_shape

FRAME = re.compile(r"frame-(\d{1,15})\.color\.(?:jpe?g|png)")
FRAMES_PER_SECOND = 30.0
_log = logging.getLogger(__name__)


def is_seven_scenes(tree: FileTree) -> bool:
    """Whether there is at least one `frame-*.color.*` picture."""
    return any(FRAME.fullmatch(name) for name in tree.names)


def open_seven_scenes(tree: FileTree | Path) -> "SevenScenes":
    """Open files in the 7-Scenes layout. Poses are read and checked now, pictures when asked for.

    Frames whose picture is damaged are left out.

    Raises:
        InputError: no such folder, no frames in it, a frame without its pose or depth file, a malformed pose,
            intrinsics that do not belong to the pictures.
    """
    return SevenScenes(open_tree(tree) if isinstance(tree, Path) else tree)


class SevenScenes(Capture):
    """Frames in number order; gaps in the numbering are fine."""

    def __init__(self, tree: FileTree) -> None:
        self.name = tree.path.resolve().stem if tree.path.is_file() else tree.path.resolve().name
        self._tree = tree
        colours = _numbered_colours(tree)
        self._has_depth = _check_companions(tree, colours)
        broken = {number: name for number, name in colours.items() if not looks_whole(tree, name)}
        first = next(iter(broken.values()), "")
        if broken:
            self.faults = (f"{len(broken)} of {len(colours)} pictures are damaged and left out (first: {first})",)
        self._colours = {number: name for number, name in colours.items() if number not in broken}
        if not self._colours:
            raise InputError(f"{tree.path}: none of {len(colours)} pictures can be read (first: {first})")
        self._poses = [_read_pose(tree, _companion(name, "pose.txt")) for name in self._colours.values()]
        self._numbers = list(self._colours)
        with tree.local(next(iter(self._colours.values()))) as file:
            height, width = picture_shape(file, tree.where(next(iter(self._colours.values()))))
        self._intrinsics = _read_intrinsics(tree, height, width)
        self.up = _read_up(tree, self._poses)

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return self._tree.fingerprint()

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: int) -> Frame:
        """Frame at a position in number order (not its number). IndexError beyond the end ends a `for` loop."""
        number, pose = self._numbers[index], self._poses[index]
        image = tree_colour(self._tree, self._colours[number])
        depth = self._depth(index, image.shape[:2]) if self._has_depth else None
        camera = Camera(self._intrinsics, pose)
        return Frame(f"frame-{number:06d}", image, camera, number / FRAMES_PER_SECOND, depth)

    def camera(self, index: int) -> Camera:
        """See `Capture`."""
        return Camera(self._intrinsics, self._poses[index])

    @property
    def depth_count(self) -> int:
        """See `Capture`."""
        return len(self) if self._has_depth else 0

    def depth_reading(self, index: int) -> DepthReading:
        """See `Capture`."""
        return DepthReading(
            self._depth(index, self._intrinsics.shape), Camera(self._intrinsics, self._poses[index])
        )

    def _depth(self, index: int, shape: tuple[int, ...]) -> Float[np.ndarray, "h w"]:
        name = _companion(self._colours[self._numbers[index]], "depth.png")
        depth = tree_depth(self._tree, name)
        if depth.shape != shape:
            raise InputError(
                f"{self._tree.where(name)}: {depth.shape[1]}x{depth.shape[0]} but the picture is "
                f"{shape[1]}x{shape[0]}; this layout has depth registered to the picture"
            )
        return depth


def _numbered_colours(tree: FileTree) -> dict[int, str]:
    """Frame number → name of the colour picture, in number order."""
    found: dict[int, str] = {}
    for name in tree.below(""):
        if match := FRAME.fullmatch(name):
            number = int(match[1])
            if number in found:
                raise InputError(f"{tree.where(name)}: frame {number} is also {found[number]}; keep one of the two")
            found[number] = name
    if not found:
        raise InputError(f"{tree.path}: no frames; looked for frame-NNNNNN.color.jpg or .png (7-Scenes layout)")
    return dict(sorted(found.items()))


def _companion(colour: str, suffix: str) -> str:
    return f"{colour.split('.')[0]}.{suffix}"


def _check_companions(tree: FileTree, colours: dict[int, str]) -> bool:
    """Whether the capture has depth: all frames or none. Every frame must have a pose."""
    with_depth = [_companion(colour, "depth.png") in tree for colour in colours.values()]
    for colour, has_depth in zip(colours.values(), with_depth):
        needed = ["pose.txt"] + (["depth.png"] if any(with_depth) and not has_depth else [])
        for suffix in needed:
            if (name := _companion(colour, suffix)) not in tree:
                raise InputError(f"{tree.where(name)}: missing; {colour} needs it (or remove that frame)")
    return all(with_depth)


def _read_pose(tree: FileTree, name: str) -> Float[np.ndarray, "4 4"]:
    pose = tree_numbers(tree, name, (4, 4))
    check_pose(pose, where=tree.where(name))
    return pose


def _read_intrinsics(tree: FileTree, height: int, width: int) -> Intrinsics:
    name = "camera-intrinsics.txt"
    path = tree.where(name)
    if name not in tree:
        if (height, width) != KINECT.shape:
            raise InputError(
                f"{path}: missing; the 7-Scenes default is for 640x480 pictures, these are {width}x{height}"
            )
        _log.warning("%s: missing; taking those of the 7-Scenes Kinect, 585 585 320 240", path)
        return KINECT
    k = tree_numbers(tree, name, (3, 3))
    if not np.allclose(k[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], (0, 0, 0, 0, 1)):
        raise InputError(f"{path}: need fx 0 cx / 0 fy cy / 0 0 1 row by row (no skew), got {k.tolist()}")
    try:
        intrinsics = Intrinsics(width, height, *(float(v) for v in k[[0, 1, 0, 1], [0, 1, 2, 2]]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    # Intrinsics of another picture size betray themselves by their principal point.
    if not (0.25 < intrinsics.cx / width < 0.75 and 0.25 < intrinsics.cy / height < 0.75):
        raise InputError(
            f"{path}: principal point ({intrinsics.cx:g}, {intrinsics.cy:g}) is far from the centre of the "
            f"{width}x{height} pictures; give the intrinsics of this picture size"
        )
    return intrinsics


def _read_up(tree: FileTree, poses: list[Float[np.ndarray, "4 4"]]) -> Float[np.ndarray, "3"]:
    """Unit vector against gravity: from the file, or the mean of the cameras' -y axes where there is none."""
    name = "gravity-direction.txt"
    path = tree.where(name)
    if name in tree:
        up = -tree_numbers(tree, name, (3,))
        if not abs(np.linalg.norm(up) - 1.0) < 0.01:
            raise InputError(f"{path}: need a unit vector, this one is {np.linalg.norm(up):.3g} long")
    else:
        up = -np.mean([pose[:3, 1] for pose in poses], axis=0)
        if not np.linalg.norm(up) > 0.1:
            raise InputError(f"{path}: missing, and the cameras' up directions cancel out; write the file")
    return up / np.linalg.norm(up)


FORMAT = CaptureFormat(
    "7-Scenes",
    is_seven_scenes,
    lambda tree: registered(open_seven_scenes(tree)),
    "frame-NNNNNN.color.jpg|png",
)
