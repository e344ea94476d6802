"""3D Scanner App's raw export ("All Data"): an iPhone's or iPad's LiDAR scan.

    frame_00012.json   pose, intrinsics, time, exposure and more of one moment
    frame_00012.jpg    the picture; only every third or so moment has one
    depth_00012.png    16-bit millimetres, 256×192
    conf_00012.png     confidence of depth, 0 to 2
    export.obj         the app's mesh, in the world of the poses
    info.json          of the whole scan; nothing in it is needed

`cameraPoseARFrame` is camera-to-world, row by row, in ARKit's axes; `intrinsics` (row by row) are of the picture's
size. Place and date, which the files may hold, are not read.

Tested on a real scan by version 1.9.5 of the app, and on small files written to this layout.
"""

import functools
import re

import numpy as np

from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import tree_colour
from hyjax.data.file_tree import FileTree
from hyjax.data.json_fields import Fields
from hyjax.data.phone_captures import (
    PIXEL_CENTRE,
    PhoneScan,
    arkit_pose,
    lens_of,
    shape_of_pictures,
)
from hyjax.data.recording import Recording, Shot

FRAME_FILE = re.compile(r"frame_(\d+)\.json")
PICTURE_FILE = re.compile(r"frame_(\d+)\.jpg")
MESH = "export.obj"
POOR_MOTION = 0.7
"""The app's `motionQuality` below which the phone moved so fast that pictures are blurred; 1 is at rest."""


def is_scanner3d(tree: FileTree) -> bool:
    """Whether there is a `frame_NNNNN.json`."""
    return any(FRAME_FILE.fullmatch(name) for name in tree.names)


def open_scanner3d(tree: FileTree) -> Recording:
    """Open a raw export. Poses are read and checked now, pictures and depth when asked for.

    Moments without a picture give their depth to fusion alone.
    """
    scan = PhoneScan(tree)
    moments = {match[1]: name for name in tree.below("") if (match := FRAME_FILE.fullmatch(name))}
    for name in tree.below(""):
        if (match := PICTURE_FILE.fullmatch(name)) and match[1] not in moments:
            scan.faults.add("pictures have no pose and are left out", name)
    pictures = {
        number: picture
        for number in moments
        if (picture := scan.whole(f"frame_{number}.jpg", "pictures")) is not None
    }
    shape = shape_of_pictures(tree, list(pictures.values()))
    reads = (
        functools.partial(_read_moment, scan, name, number, pictures.get(number), shape)
        for number, name in moments.items()
    )
    return scan.recording(scan.usable(reads), mesh=MESH)


def _read_moment(
    scan: PhoneScan, name: str, number: str, picture: str | None, shape: tuple[int, int]
) -> Shot | None:
    tree = scan.tree
    fields = Fields.of(tree, name)
    pose = arkit_pose(fields.numbers("cameraPoseARFrame", 16, finite=False).reshape(4, 4))
    k = fields.numbers("intrinsics", 9)
    lens = lens_of(shape, k[[0, 4, 2, 5]].tolist(), f"{fields.where}: intrinsics", shift=PIXEL_CENTRE)
    time = fields.number("time")
    exposure = fields.number("exposureDuration", np.inf)
    quality = fields.number("motionQuality", 1.0)
    if pose is not None and quality < POOR_MOTION:
        scan.remarks.add(f"frames were taken in fast motion (motionQuality below {POOR_MOTION:g})", name)
    return scan.shot(
        name,
        name.removesuffix(".json"),
        time,
        pose,
        lens,
        None if picture is None else functools.partial(tree_colour, tree, picture),
        scan.depth(f"depth_{number}.png", f"conf_{number}.png"),
        exposure=exposure if 0 < exposure < np.inf else None,
    )


FORMAT = CaptureFormat("3D Scanner App", is_scanner3d, open_scanner3d, "frame_NNNNN.json, depth_NNNNN.png")
