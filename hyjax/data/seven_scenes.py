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
from hyjax.data.capture_files import fingerprint, read_colour, read_numbers
from hyjax.data.kinect import KINECT, registered
from hyjax.geometry.camera import Camera, Intrinsics, check_pose
from hyjax.util.errors import InputError
from hyjax.util.images import read_depth

FRAME = re.compile(r"frame-(\d+)\.color\.(?:jpe?g|png)")
FRAMES_PER_SECOND = 30.0
_log = logging.getLogger(__name__)


def is_seven_scenes(path: Path) -> bool:
    """Whether `path` is a folder with at least one `frame-*.color.*` picture."""
    return path.is_dir() and any(FRAME.fullmatch(entry.name) for entry in path.iterdir())


def open_seven_scenes(path: Path) -> "SevenScenes":
    """Open a folder in the 7-Scenes layout. Poses are read and checked now, pictures when asked for.

    Raises:
        InputError: no such folder, no frames in it, a frame without its pose or depth file, a malformed pose,
            intrinsics that do not belong to the pictures.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give the folder that holds frame-*.color.jpg|png")
    return SevenScenes(path)


class SevenScenes(Capture):
    """A folder's frames in number order; gaps in the numbering are fine."""

    def __init__(self, path: Path) -> None:
        self.name = path.resolve().name
        self._path = path.resolve()
        self._colours = _numbered_colours(path)
        self._has_depth = _check_companions(self._colours)
        self._poses = [_read_pose(_companion(colour, "pose.txt")) for colour in self._colours.values()]
        self._numbers = list(self._colours)
        height, width = read_colour(next(iter(self._colours.values()))).shape[:2]
        self._intrinsics = _read_intrinsics(path / "camera-intrinsics.txt", height, width)
        self.up = _read_up(path / "gravity-direction.txt", self._poses)

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return fingerprint(self._path, [self._path])

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: int) -> Frame:
        """Frame at a position in number order (not its number). IndexError beyond the end ends a `for` loop.

        Raises:
            InputError: a picture is damaged or of another size than the intrinsics.
        """
        number, pose = self._numbers[index], self._poses[index]
        colour = self._colours[number]
        image = read_colour(colour)
        depth = read_depth(_companion(colour, "depth.png")) if self._has_depth else None
        if depth is not None and depth.shape != image.shape[:2]:
            raise InputError(
                f"{_companion(colour, 'depth.png')}: {depth.shape[1]}x{depth.shape[0]} but the picture is "
                f"{image.shape[1]}x{image.shape[0]}; this layout has depth registered to the picture"
            )
        camera = Camera(self._intrinsics, pose)
        return Frame(f"frame-{number:06d}", image, camera, number / FRAMES_PER_SECOND, depth)


def _numbered_colours(path: Path) -> dict[int, Path]:
    """Frame number → colour picture, in number order."""
    found: dict[int, Path] = {}
    for entry in sorted(path.iterdir()):
        if match := FRAME.fullmatch(entry.name):
            number = int(match[1])
            if number in found:
                raise InputError(f"{entry}: frame {number} is also {found[number].name}; keep one of the two")
            found[number] = entry
    if not found:
        raise InputError(f"{path}: no frames; looked for frame-NNNNNN.color.jpg or .png (7-Scenes layout)")
    return dict(sorted(found.items()))


def _companion(colour: Path, suffix: str) -> Path:
    return colour.with_name(f"{colour.name.split('.')[0]}.{suffix}")


def _check_companions(colours: dict[int, Path]) -> bool:
    """Whether the capture has depth: all frames or none. Every frame must have a pose."""
    with_depth = [_companion(colour, "depth.png").is_file() for colour in colours.values()]
    for colour, has_depth in zip(colours.values(), with_depth):
        needed = ["pose.txt"] + (["depth.png"] if any(with_depth) and not has_depth else [])
        for suffix in needed:
            if not (file := _companion(colour, suffix)).is_file():
                raise InputError(f"{file}: missing; {colour.name} needs it (or remove that frame)")
    return all(with_depth)


def _read_pose(path: Path) -> Float[np.ndarray, "4 4"]:
    pose = read_numbers(path, (4, 4))
    check_pose(pose, where=str(path))
    return pose


def _read_intrinsics(path: Path, height: int, width: int) -> Intrinsics:
    if not path.is_file():
        if (height, width) != KINECT.shape:
            raise InputError(
                f"{path}: missing; the 7-Scenes default is for 640x480 pictures, these are {width}x{height}"
            )
        _log.warning("%s: missing; taking those of the 7-Scenes Kinect, 585 585 320 240", path)
        return KINECT
    k = read_numbers(path, (3, 3))
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


def _read_up(path: Path, poses: list[Float[np.ndarray, "4 4"]]) -> Float[np.ndarray, "3"]:
    """Unit vector against gravity: from the file, or the mean of the cameras' -y axes where there is none."""
    if path.is_file():
        up = -read_numbers(path, (3,))
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
    lambda path: registered(open_seven_scenes(path)),
    "frame-NNNNNN.color.jpg|png",
)
