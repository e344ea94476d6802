"""Record3D's exports: "EXR + RGB" folders, and `.r3d` files.

    metadata.json   or, in an .r3d (a ZIP archive), metadata
    rgb/12.jpg                 rgbd/12.jpg      the picture, portrait
    depth/12.exr               rgbd/12.depth    metres; one channel R; in an .r3d float32, LZFSE-compressed
                               rgbd/12.conf     confidence 0 to 2, a byte a reading, LZFSE-compressed

`metadata` has for all frames `w`, `h` (of pictures), `dw`, `dh` (of depth), `fps`, `K` (9 numbers, column by
column) and for each `poses` (qx qy qz qw tx ty tz, camera-to-world, camera in ARKit's axes),
`perFrameIntrinsicCoeffs` (fx fy cx cy) and `frameTimestamps` (seconds); the last two are not in older files. Frame
12 is entry 12 of the lists: numbers may be missing in between. Where the poses begin at the first camera,
`initPose` places that in a world that is y-up; without it gravity is taken from how the camera was held.

Principal points are taken as they are: whether the app has pixel centres at whole numbers is not told.

Tested on small files written to this layout, on no real export.

Source: the app's author in the issues of github.com/marek-simonik/record3d (27, 33, 36).
"""

import functools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import Tally, tree_colour
from hyjax.data.file_tree import FileTree
from hyjax.data.json_fields import Fields
from hyjax.data.lzfse_blocks import unpacked_size
from hyjax.data.phone_captures import (
    PhoneScan,
    confidence_from_levels,
    lens_of,
    shape_of_pictures,
)
from hyjax.data.recording import Y_UP, DepthAndConfidence, Recording, from_opengl, pose_from_quaternion
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

PICTURE = re.compile(r"(?:rgb|rgbd)/(\d{1,9})\.jpe?g")
DEPTH = re.compile(r"(?:depth/(\d{1,9})\.exr|rgbd/(\d{1,9})\.depth)")
FRAMES_PER_SECOND = 30.0
"""Default frame rate, for files without one."""
MOST_READINGS = 1 << 22
"""Most readings of a depth map; the largest that the app writes has 640×480."""
PACKING_SLACK = 4096
"""Bytes by which incompressible data may grow."""


def is_record3d(tree: FileTree) -> bool:
    """Whether there are `metadata.json` and `rgb/`, or `metadata` and `rgbd/`."""
    return ("metadata.json" in tree or "metadata" in tree) and any(map(PICTURE.fullmatch, tree.names))


def open_record3d(tree: FileTree) -> Recording:
    """Open an export. `metadata` is read and checked now, pictures and depth when asked for."""
    name = "metadata.json" if "metadata.json" in tree else "metadata"
    metadata = Fields.of(tree, name)
    scan = PhoneScan(tree)
    files = {int(match[1]): file for file in tree.names if (match := PICTURE.fullmatch(file))}
    pictures = {number: file for number, file in files.items() if scan.whole(file, "pictures")}
    depths = {int(match[1] or match[2]): file for file in tree.names if (match := DEPTH.fullmatch(file))}
    if any(file.endswith(".depth") for file in depths.values()):
        _lzfse()
    poses, up = _read_poses(metadata, scan.remarks)
    lens_by_number = _lenses(metadata, shape_of_pictures(tree, list(pictures.values())))
    times, rate = _read_times(metadata)
    shots = []
    for number in sorted({*pictures, *depths}):
        picture, depth = pictures.get(number), depths.get(number)
        if number >= len(poses):
            scan.faults.add("frames have no pose and are left out", str(picture or depth))
            continue
        pose, lens = poses[number], lens_by_number(number)
        shot = scan.shot(
            str(picture or depth),
            f"frame_{number:06d}",
            times[number] if number < len(times) else number / rate,
            None if pose is None else from_opengl(pose),
            lens,
            None if picture is None else functools.partial(tree_colour, tree, picture),
            None if depth is None else functools.partial(_read_depth, tree, depth, metadata, lens),
        )
        if shot is not None:
            shots.append(shot)
    unused = [number for number in range(len(poses)) if number not in files]
    for number in unused:
        scan.remarks.add("poses have no picture", f"number {number}")
    return scan.recording(shots, up=up)


Pose = Float[np.ndarray, "4 4"]


def _read_poses(metadata: Fields, remarks: Tally) -> tuple[list[Pose | None], Float[np.ndarray, "3"] | None]:
    """Camera-to-world poses (None where invalid) in ARKit's axes, and up; None if gravity is unknown."""
    poses = [pose_from_quaternion(row[:4], row[4:]) for row in metadata.rows("poses", 7)]
    known = [pose for pose in poses if pose is not None]
    if len(known) > 1 and all(np.allclose(pose, known[0], atol=1e-9) for pose in known):
        raise InputError(
            f"{metadata.where}: poses are all the same; the selfie camera has none, and a scan needs motion"
        )
    if not poses or poses[0] is None or not np.allclose(poses[0], np.eye(4), atol=1e-4):
        return poses, Y_UP
    if "initPose" in metadata:
        row = metadata.numbers("initPose", 7, finite=False)
        start = pose_from_quaternion(row[:4], row[4:])
        if start is not None and not np.allclose(start[:3, :3], np.eye(3), atol=1e-4):
            return [None if pose is None else start @ pose for pose in poses], Y_UP
    remarks.add("pose begins the world, so gravity is taken from how the camera was held", "poses[0]")
    return poses, None


def _read_times(metadata: Fields) -> tuple[list[float], float]:
    """Times of the frames in seconds where known, and the frame rate for the others."""
    rate = metadata.number("fps", FRAMES_PER_SECOND)
    if not 0.01 <= rate <= 1e4:
        raise InputError(f"{metadata.where}: fps: need pictures a second, got {rate:g}")
    if "frameTimestamps" not in metadata:
        return [], rate
    return metadata.numbers("frameTimestamps").tolist(), rate


def _lenses(metadata: Fields, shape: tuple[int, int]) -> Callable[[int], Intrinsics]:
    """Intrinsics by a frame's number, in the size in which pictures are stored."""
    where, (height, width) = metadata.where, (metadata.count("h"), metadata.count("w"))
    if abs(height * shape[1] / (width * shape[0]) - 1.0) > 0.01:
        raise InputError(f"{where}: w and h are {width} and {height}, but pictures are {shape[1]}x{shape[0]}")
    each = "perFrameIntrinsicCoeffs"
    values = metadata.rows(each, 4, finite=True) if each in metadata else np.zeros((0, 4))

    def scaled(k: Float[np.ndarray, "4"], key: str) -> Intrinsics:
        return lens_of((height, width), k.tolist(), f"{where}: {key}").resize(*shape)

    common = scaled(_of_matrix(metadata.numbers("K", 9)), "K")
    return lambda number: scaled(values[number], f"{each}[{number}]") if number < len(values) else common


def _of_matrix(k: Float[np.ndarray, "9"]) -> Float[np.ndarray, "4"]:
    """fx, fy, cx, cy of K, which other programs than the app write row by row."""
    return k[[0, 4, 2, 5]] if not k[6:8].any() and k[[2, 5]].all() else k[[0, 4, 6, 7]]


def _read_depth(tree: FileTree, name: str, metadata: Fields, lens: Intrinsics) -> DepthAndConfidence:
    if name.endswith(".exr"):
        with tree.local(name) as path:
            return _positive(read_image(path, tree.where(name))[..., 0]), None
    metres = _unpacked(tree, name, np.float32, metadata, lens)
    other = name.removesuffix("depth") + "conf"
    if other not in tree:
        return _positive(metres), None
    levels = _unpacked(tree, other, np.uint8, metadata, lens)
    if levels.shape != metres.shape:
        raise InputError(f"{tree.where(other)}: not of the size of its depth map")
    return _positive(metres), confidence_from_levels(levels)


def _positive(metres: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Depth with 0 in place of invalid readings: NaN, infinite, negative."""
    return np.where(np.isfinite(metres) & (metres > 0), metres, 0.0).astype(np.float32)


def _unpacked(
    tree: FileTree, name: str, kind: type, metadata: Fields, lens: Intrinsics
) -> Float[np.ndarray, "h w"]:
    """An LZFSE-compressed array, in the pictures' proportions if `metadata` has no size for it."""
    lzfse, shape = _lzfse(), None
    if "dw" in metadata and "dh" in metadata:
        shape = metadata.count("dh"), metadata.count("dw")
    most = MOST_READINGS if shape is None else min(shape[0] * shape[1], MOST_READINGS)
    if tree.size(name) > most * np.dtype(kind).itemsize + PACKING_SLACK:
        raise InputError(f"{tree.where(name)}: larger than a depth map can be that is compressed")
    values: np.ndarray
    content = tree.read(name)
    size = unpacked_size(content)
    if size is None or size > most * np.dtype(kind).itemsize:
        raise InputError(f"{tree.where(name)}: damaged (is no LZFSE, or unpacks to more than a depth map has)")
    try:
        values = np.frombuffer(lzfse.decompress(content), kind)
    except (lzfse.error, ValueError, MemoryError):
        raise InputError(f"{tree.where(name)}: damaged (cannot be decompressed by LZFSE)") from None
    if shape is None:
        width = max(1, round((values.size * lens.width / lens.height) ** 0.5))
        shape = values.size // width, width
    if values.size != shape[0] * shape[1] or not values.size:
        raise InputError(f"{tree.where(name)}: holds {values.size} readings, need {shape[1]}x{shape[0]} (dw, dh)")
    return values.reshape(shape)


def _lzfse() -> Any:
    try:
        import lzfse
    except ImportError:
        raise InputError(
            "depth of .r3d files needs the package lzfse; install it with: pip install '.[captures]' "
            "(or export EXR + RGB from the app)"
        ) from None
    return lzfse


FORMAT = CaptureFormat(
    "Record3D", is_record3d, open_record3d, "metadata.json, rgb/N.jpg, depth/N.exr; or an .r3d file"
)
