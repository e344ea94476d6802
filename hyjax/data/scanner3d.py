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
from hyjax.data.capture_files import Tally, tree_colour
from hyjax.data.file_tree import FileTree
from hyjax.data.json_fields import json_number, json_numbers, json_object
from hyjax.data.phone_captures import (
    PIXEL_CENTRE,
    in_order_of_time,
    lens_of,
    lidar_depth,
    shape_of_pictures,
    usable_pose,
    usable_shots,
    whole_file,
)
from hyjax.data.recording import Y_UP, Recording, Shot, from_opengl
from hyjax.geometry.depth_sensor import PHONE_LIDAR

MOMENT = re.compile(r"frame_(\d+)\.json")
MESH = "export.obj"
POOR_MOTION = 0.7
"""The app's `motionQuality` below which the phone moved so fast that pictures are blurred; 1 is at rest."""


def is_scanner3d(tree: FileTree) -> bool:
    """Whether there is a `frame_NNNNN.json`."""
    return any(MOMENT.fullmatch(name) for name in tree.names)


def open_scanner3d(tree: FileTree) -> Recording:
    """Open a raw export. Poses are read and checked now, pictures and depth when asked for.

    Moments without a picture give their depth to fusion alone.
    """
    faults, remarks = Tally(), Tally()
    moments = {match[1]: name for name in tree.below("") if (match := MOMENT.fullmatch(name))}
    pictures = {
        number: picture
        for number in moments
        if (picture := whole_file(tree, f"frame_{number}.jpg", "pictures", faults)) is not None
    }
    shape = shape_of_pictures(tree, list(pictures.values()))
    reads = (
        functools.partial(_read_moment, tree, name, number, pictures.get(number), shape, faults, remarks)
        for number, name in moments.items()
    )
    shots = usable_shots(reads, faults)
    return Recording(
        tree,
        in_order_of_time(shots, remarks),
        up=Y_UP,
        mesh=MESH if MESH in tree else None,
        sensor=PHONE_LIDAR,
        faults=faults.lines(),
        remarks=remarks.lines(),
    )


def _read_moment(
    tree: FileTree,
    name: str,
    number: str,
    picture: str | None,
    shape: tuple[int, int],
    faults: Tally,
    remarks: Tally,
) -> Shot | None:
    fields, where = json_object(tree, name), tree.where(name)
    pose = usable_pose(json_numbers(fields, "cameraPoseARFrame", 16, where, finite=False).reshape(4, 4))
    k = json_numbers(fields, "intrinsics", 9, where)
    lens = lens_of(shape, k[[0, 4, 2, 5]].tolist(), f"{where}: intrinsics", shift=PIXEL_CENTRE)
    time = json_number(fields, "time", where)
    exposure = json_number(fields, "exposureDuration", where, default=np.inf)
    quality = json_number(fields, "motionQuality", where, default=1.0)
    depth = whole_file(tree, f"depth_{number}.png", "depth maps", faults)
    confidence = whole_file(tree, f"conf_{number}.png", "confidence maps", faults)
    if pose is None:
        faults.add("poses are none (not finite, or no rotation) and left out", name)
        return None
    if quality < POOR_MOTION:
        remarks.add(f"frames were taken in fast motion (motionQuality below {POOR_MOTION:g})", name)
    if picture is None:
        remarks.add("poses have no picture" + ("; their depth is used" if depth else " and no depth"), name)
    elif depth is None:
        remarks.add("pictures have no depth", picture)
    return Shot(
        name.removesuffix(".json"),
        time,
        from_opengl(pose),
        lens,
        None if picture is None else functools.partial(tree_colour, tree, picture),
        None if depth is None else lidar_depth(tree, depth, confidence),
        exposure=exposure if 0 < exposure < np.inf else None,
    )


FORMAT = CaptureFormat("3D Scanner App", is_scanner3d, open_scanner3d, "frame_NNNNN.json, depth_NNNNN.png")
