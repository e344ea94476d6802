"""Polycam's raw data ("keyframes"): an iPhone's or iPad's LiDAR or room scan.

    keyframes/cameras/<microseconds>.json   t_00 to t_23 (3×4 camera-to-world, ARKit's axes), fx fy cx cy, width,
                                            height, blur_score, timestamp
    keyframes/images/….jpg                  the picture
    keyframes/depth/….png                   16-bit millimetres, 256×192
    keyframes/confidence/….png              0, 54 (medium) or 255
    keyframes/corrected_cameras/, keyframes/corrected_images/, keyframes/corrected_depth/
                                            the same after the app has adjusted poses and undone the lens; not of
                                            every scan, and not of every keyframe
    mesh_info.json, raw.glb                 not read: the mesh is moved against the poses

Corrected cameras and pictures are preferred. The world is y-up, in metres.

Tested on small files written to this layout, on no real export.

Source: github.com/PolyCam/polyform.
"""

import functools

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
)
from hyjax.data.recording import Recording, Shot

RAW, CORRECTED = "keyframes/cameras", "keyframes/corrected_cameras"
CONFIDENCE_LEVELS = (0, 54, 255)


def is_polycam(tree: FileTree) -> bool:
    """Whether there are `keyframes/cameras/*.json` or `keyframes/corrected_cameras/*.json`."""
    return bool(tree.below(RAW, ".json") or tree.below(CORRECTED, ".json"))


def open_polycam(tree: FileTree) -> Recording:
    """Open raw data. Cameras are read and checked now, pictures and depth when asked for.

    Keyframes that the app has not corrected are left out of a scan that it has.
    """
    scan = PhoneScan(tree)
    corrected = bool(tree.below(CORRECTED, ".json") and tree.below("keyframes/corrected_images"))
    cameras = tree.below(CORRECTED if corrected else RAW, ".json")
    names = [camera.rpartition("/")[2].removesuffix(".json") for camera in cameras]
    if corrected:
        known = set(names)
        for camera in tree.below(RAW, ".json"):
            if camera.rpartition("/")[2].removesuffix(".json") not in known:
                scan.remarks.add("keyframes were not corrected by the app and are left out", camera)
    images = "keyframes/corrected_images" if corrected else "keyframes/images"
    has_corrected_depth = corrected and bool(tree.below("keyframes/corrected_depth", ".png"))
    depths = "keyframes/corrected_depth" if has_corrected_depth else "keyframes/depth"
    reads = (
        functools.partial(_read_keyframe, scan, camera, name, index, images, depths)
        for index, (camera, name) in enumerate(zip(cameras, names))
    )
    return scan.recording(scan.usable(reads))


def _read_keyframe(scan: PhoneScan, camera: str, name: str, index: int, images: str, depths: str) -> Shot | None:
    tree = scan.tree
    fields = Fields.of(tree, camera)
    rows = [[fields.number(f"t_{row}{column}", finite=False) for column in range(4)] for row in range(3)]
    pose = arkit_pose(np.array([*rows, [0.0, 0.0, 0.0, 1.0]]))
    size = fields.count("height"), fields.count("width")
    values = [fields.number(key) for key in ("fx", "fy", "cx", "cy")]
    lens = lens_of(size, values, fields.where, shift=PIXEL_CENTRE)
    microseconds = float(name) if name.isascii() and name.isdigit() and len(name) <= 16 else float(index)
    time = fields.number("timestamp", microseconds) / 1e6
    found = [file for suffix in ("jpg", "jpeg", "png") if (file := f"{images}/{name}.{suffix}") in tree]
    picture = scan.whole(found[0], "pictures") if found else None
    return scan.shot(
        camera,
        name,
        time,
        pose,
        lens,
        None if picture is None else functools.partial(tree_colour, tree, picture),
        scan.depth(f"{depths}/{name}.png", f"keyframes/confidence/{name}.png", levels=CONFIDENCE_LEVELS),
    )


FORMAT = CaptureFormat("Polycam", is_polycam, open_polycam, "keyframes/cameras/*.json")
