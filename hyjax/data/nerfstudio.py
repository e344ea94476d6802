"""nerfstudio's and instant-ngp's `transforms.json`, and Blender's as NeRF's synthetic scenes have it.

    transforms.json    intrinsics (fl_x, fl_y, cx, cy, w, h, k1, …, or camera_angle_x alone), of the file or of each
                       of its `frames`; these have file_path, transform_matrix (camera-to-world, camera x right,
                       y up, z backward) and perhaps depth_file_path

Pixel coordinates have the centre of the first pixel at 0.5, as here: nerfstudio takes COLMAP's. Which way is up:
`up` of instant-ngp; z where the file says that it was oriented (`orientation_override` is `none`) or comes from
Blender (no focal length but camera_angle_x); with a sensor's depth, which devices with a sense of gravity give, the
world axis next to the cameras' mean up direction; that direction itself otherwise, as nerfstudio does. The unit is
metres if there is depth, which is in the unit of the poses, and not known otherwise. Point clouds and masks are not
read.

Tested on files written to the published layout, not on a real capture.

Sources: docs.nerf.studio/quickstart/data_conventions.html; instant-ngp, docs/nerf_dataset_tips.md.
"""

import functools
import math
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
from hyjax.data.lens import Distortion
from hyjax.data.recording import Z_UP, Recording, Shot, depth_reader, from_opengl, mean_up, rigid
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError

NAMES = ("transforms.json", "transforms_train.json")
"""Names of files that list the frames: the second is Blender's, of the part to train on."""
ENDINGS = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "POLYCAM", "PERSPECTIVE")
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
AXIS_WITHIN = math.cos(math.radians(20.0))
"""Cosine between the cameras' mean up direction and a world axis that is taken for up."""


def is_nerfstudio(tree: FileTree) -> bool:
    """Whether there is a `transforms.json` or Blender's `transforms_train.json`."""
    return any(name in tree for name in NAMES)


def open_nerfstudio(tree: FileTree) -> Recording:
    """Open a folder or archive with a `transforms.json`, or the path of that file itself."""
    listing = next(name for name in NAMES if name in tree)
    if tree.path.is_file() and tree.names == (listing,):
        tree = open_tree(tree.path.resolve().parent)
    top = Fields.of(tree, listing)
    found = [(entry, _find(tree, entry.text("file_path"))) for entry in top.objects("frames")]
    found.sort(key=lambda pair: by_number(pair[1] or pair[0].text("file_path")))
    remarks, faults = Tally(), Tally()
    chosen: dict[str, Fields] = {}
    for entry, name in found:
        if name is None:
            faults.add("frames are left out, their pictures are missing", entry.text("file_path"))
        elif name in chosen:
            remarks.add("frames name a picture that another one has named", name)
        elif not looks_whole(tree, name):
            faults.add("pictures are damaged and left out", name)
        elif rigid(_pose(entry)) is None:
            faults.add("frames are left out, their poses are no rigid motions", name)
        else:
            chosen[name] = entry
    shots = [
        _shot(tree, top, entry, name, short, index, faults)
        for index, ((name, entry), short) in enumerate(zip(chosen.items(), short_names(list(chosen))))
    ]
    has_depth = any(shot.depth is not None for shot in shots)
    up, up_remarks = _up(top, [shot.pose for shot in shots], has_depth, tree) if shots else (Z_UP, [])
    if listing != NAMES[0]:
        up_remarks = [*up_remarks, f"there is no {NAMES[0]}; the frames are those of {listing}"]
    return Recording(
        tree,
        shots,
        up=up,
        faults=faults.lines(),
        remarks=[*remarks.lines(), *up_remarks],
        metric=has_depth,
        depth_in_units=True,
        times_known=False,
    )


def _find(tree: FileTree, path: str) -> str | None:
    """Name of the file that a path means: the path's tail if it is of another machine; None if there is none."""
    parts = PurePosixPath(path.replace("\\", "/")).parts
    foreign = bool(parts) and (parts[0] == "/" or ":" in parts[0] or ".." in parts)
    inside = [part for part in parts if part not in ("/", "..")]
    for start in range(len(inside) if foreign else min(1, len(inside))):
        for ending in ENDINGS:
            if (name := "/".join(inside[start:]) + ending) in tree:
                return name
    return None


def _pose(entry: Fields) -> Float[np.ndarray, "4 4"]:
    rows = entry.rows("transform_matrix", 4)
    if len(rows) not in (3, 4):
        raise InputError(f"{entry.where}: transform_matrix: need 4x4 or 3x4 numbers, got {len(rows)} rows")
    pose = np.eye(4)
    pose[: len(rows)] = rows
    return pose


def _shot(tree: FileTree, top: Fields, entry: Fields, name: str, short: str, index: int, faults: Tally) -> Shot:
    pose = rigid(_pose(entry))
    assert pose is not None
    key = next((key for key in ("depth_file_path", "depth_path") if key in entry), None)
    depth = None
    if key is not None:
        found = _find(tree, entry.text(key))
        if found is None:
            faults.add("depth maps are missing", entry.text(key))
        elif not found.lower().endswith(".png"):
            raise InputError(f"{entry.where}: {key}: only 16-bit PNG is read as depth, not {found}")
        elif not looks_whole(tree, found):
            faults.add("depth maps are damaged and left out", found)
        else:
            depth = depth_reader(tree, found, _depth_unit(top))
    exposure = entry.number("exposure_time", 0.0)
    return Shot(
        short,
        float(index),
        from_opengl(pose),
        _intrinsics(tree, top, entry, name),
        functools.partial(tree_colour, tree, name),
        depth,
        distortion=_distortion(top, entry),
        exposure=exposure if exposure > 0 else None,
    )


def _depth_unit(top: Fields) -> float:
    """Step of a depth map in the poses' units: nerfstudio's key, or instant-ngp's."""
    key = "integer_depth_scale" if "integer_depth_scale" in top else "depth_unit_scale_factor"
    unit = top.number(key, 0.001)
    if not 0 < unit < 1e3:
        raise InputError(f"{top.where}: {key}: must be > 0 and below 1000, got {unit:g}")
    return unit


def _either(top: Fields, entry: Fields, key: str) -> Fields:
    """The frame's fields if it has this key, the file's otherwise."""
    return entry if key in entry else top


def _intrinsics(tree: FileTree, top: Fields, entry: Fields, name: str) -> Intrinsics:
    sizes = [_either(top, entry, key) for key in ("h", "w")]
    if "h" in sizes[0] and "w" in sizes[1]:
        height, width = sizes[0].count("h"), sizes[1].count("w")
    else:
        height, width = tree_shape(tree, name)
    fx = _focal(top, entry, "x", width)
    has_y = any(key in fields for key in ("fl_y", "camera_angle_y") for fields in (top, entry))
    fy = _focal(top, entry, "y", height) if has_y else fx
    cx = _either(top, entry, "cx").number("cx", width / 2)
    cy = _either(top, entry, "cy").number("cy", height / 2)
    return intrinsics_at(entry.where, width, height, fx, fy, cx, cy)


def _focal(top: Fields, entry: Fields, axis: str, side: int) -> float:
    """Focal length in pixels along an axis: given, or from the whole angle of view."""
    focal, angle = f"fl_{axis}", f"camera_angle_{axis}"
    if focal in _either(top, entry, focal) or angle not in _either(top, entry, angle):
        return _either(top, entry, focal).number(focal)
    radians = _either(top, entry, angle).number(angle)
    if not 0 < radians < math.pi:
        raise InputError(f"{top.where}: {angle}: must be between 0 and π, got {radians:g}")
    return side / 2 / math.tan(radians / 2)


def _distortion(top: Fields, entry: Fields) -> Distortion | None:
    model = _either(top, entry, "camera_model").text("camera_model", "OPENCV").upper()
    k1, k2, k3, k4, p1, p2 = (
        _either(top, entry, key).number(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")
    )
    if model in FISHEYE or top.flag("is_fisheye", False):
        return Distortion("fisheye", (k1, k2, k3, k4))
    if model not in PERSPECTIVE:
        known = ", ".join((*PERSPECTIVE[:5], FISHEYE[0]))
        raise InputError(f"{top.where}: camera_model {model[:40]!r} is not read, only {known}; undistort it first")
    if k4:  # nerfstudio does not read it either
        raise InputError(f"{top.where}: k4: goes with camera_model {FISHEYE[0]} only")
    distortion = Distortion("brown", (k1, k2, k3), (p1, p2))
    return None if distortion.is_none else distortion


def _up(
    top: Fields, poses: list[Float[np.ndarray, "4 4"]], has_depth: bool, tree: FileTree
) -> tuple[Float[np.ndarray, "3"], list[str]]:
    """Unit vector against gravity, and a line that says how it is known."""
    if "up" in top:
        up = top.numbers("up", 3)
        length = float(np.linalg.norm(up))
        if not 1e-6 < length < 1e6:
            raise InputError(f"{top.where}: up: must be a direction, got {up.tolist()}")
        return up / length, []
    if top.text("orientation_override", "") == "none":
        return Z_UP, ["z is up, as the file says that it was oriented"]
    if not any("fl_x" in fields for fields in (top, *top.objects("frames"))):
        return Z_UP, ["z is up, as in Blender's files"]
    mean = mean_up(poses, tree.path)
    axis = np.zeros(3)
    axis[np.abs(mean).argmax()] = np.sign(mean[np.abs(mean).argmax()])
    if has_depth and axis @ mean > AXIS_WITHIN:
        return axis, [
            f"{'-' * bool(axis.min() < 0)}{'xyz'[np.abs(axis).argmax()]} is up, next to the cameras' own up"
        ]
    return mean, ["up is the cameras' mean up direction; the files have no direction of gravity"]


FORMAT = CaptureFormat("nerfstudio", is_nerfstudio, open_nerfstudio, "transforms.json")
