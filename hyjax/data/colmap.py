"""COLMAP's models with their pictures: a project, or the workspace of its dense reconstruction.

    images/                              pictures, in folders too
    sparse/0/, sparse/, colmap/sparse/0/ or top: cameras, images and points3D as .bin or .txt
    dense/ or dense/0/                   undistorted pictures, their model, `stereo/depth_maps/*.geometric.bin` and
                                         `meshed-*.ply`: preferred where depth maps are in it
    depth/ or depths/                    16-bit millimetres of a sensor, named after the pictures, in folders as
                                         they are where names alone do not tell; not of COLMAP

Camera axes are ours, pixel coordinates have the centre of the first pixel at 0.5 as here. The unit is not
metres: a sensor's depth tells it, as the median ratio to the depth of the sparse points; otherwise `--scale` does.
Up is the cameras' mean up direction. A sensor's depth is taken to be that of a
pinhole with the picture's intrinsics.

Tested on models written by pycolmap, not on a real capture.

Sources: colmap.github.io/format.html and cameras.html; Schönberger & Frahm, "Structure-from-motion revisited", CVPR
2016.
"""

import functools
import tempfile
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture, CaptureFormat
from hyjax.data.capture_files import Tally, by_number, looks_whole, short_names, tree_colour, tree_depth
from hyjax.data.colmap_files import check_binary, read_array
from hyjax.data.file_tree import FileTree
from hyjax.data.frames import spread
from hyjax.data.lens import Distortion
from hyjax.data.recording import DepthAndConfidence, Recording, Shot, rigid
from hyjax.data.scaled import ScaledCapture
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.util.errors import InputError
from hyjax.util.extras import optional_module

MODELS = ("sparse/0/", "sparse/", "colmap/sparse/0/", "colmap/sparse/", "")
WORKSPACES = ("dense/", "dense/0/")
PARTS = ("cameras", "images", "points3D")
DEPTHS = ("depth", "depths")
MESHES = ("meshed-poisson.ply", "meshed-delaunay.ply")
PICTURES = (".jpg", ".jpeg", ".png")
MOST_MEASURED_PICTURES, FEWEST_POINTS = 20, 30
"""Depth maps that the scale is taken from, and points that it needs."""

LENSES: dict[str, tuple[str, str]] = {
    "SIMPLE_PINHOLE": ("f cx cy", "brown"),
    "PINHOLE": ("fx fy cx cy", "brown"),
    "SIMPLE_RADIAL": ("f cx cy k1", "brown"),
    "RADIAL": ("f cx cy k1 k2", "brown"),
    "OPENCV": ("fx fy cx cy k1 k2 p1 p2", "brown"),
    "FULL_OPENCV": ("fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6", "brown"),
    "OPENCV_FISHEYE": ("fx fy cx cy k1 k2 k3 k4", "fisheye"),
}
"""Parameters of the camera models that are read, in COLMAP's order."""


def is_colmap(tree: FileTree) -> bool:
    """Whether there is a model and no `transforms.json`, which nerfstudio would have made from it."""
    return "transforms.json" not in tree and _model(tree) is not None


def open_colmap(tree: FileTree) -> Capture:
    """Open a model with its pictures."""
    found = _model(tree)
    assert found is not None
    folder, kind = found
    model = _read_model(tree, folder, kind)
    top = next((workspace for workspace in WORKSPACES if folder.startswith(workspace)), "")
    pictures = _pictures(tree, top)
    faults = Tally()
    chosen: dict[str, Any] = {}
    for image in sorted(model.images.values(), key=lambda image: by_number(image.name)):
        name = pictures.get(image.name)
        if not image.has_pose:
            continue
        if name is None:
            faults.add("pictures of the model are missing", image.name)
        elif not looks_whole(tree, name):
            faults.add("pictures are damaged and left out", name)
        elif _pose(image) is None:
            faults.add("pictures are left out, their poses are no rigid motions", name)
        else:
            chosen[name] = image
    remarks = ["up is the cameras' mean up direction; the files have no direction of gravity"]
    posed = {image.name for image in model.images.values() if image.has_pose}
    if unknown := sorted((name for name in pictures if name not in posed), key=by_number):
        remarks.append(
            f"{len(unknown)} of {len(pictures)} pictures are not registered in the model (first: {unknown[0]})"
        )
    maps = _depth_names(tree, top, chosen)
    broken = {depth: None for depth in maps.values() if not looks_whole(tree, depth)}
    for depth in broken:
        faults.add("depth maps are damaged and left out", depth)
    maps = {name: depth for name, depth in maps.items() if depth not in broken}
    shots = [
        _shot(tree, image, name, short, index, maps.get(name))
        for index, ((name, image), short) in enumerate(zip(chosen.items(), short_names(list(chosen))))
    ]
    has_sensor = any(not depth.endswith(".bin") for depth in maps.values())
    mesh = next((n for prefix in (top, *WORKSPACES) for m in MESHES if (n := prefix + m) in tree), None)
    scale, line = _scale(model, chosen, shots) if has_sensor else (None, "")
    recording = Recording(
        tree,
        shots,
        mesh=mesh,
        faults=faults.lines(),
        remarks=[*remarks, line] if line else remarks,
        metric=scale is not None,
        depth_in_units=not has_sensor,
        times_known=False,
    )
    return recording if scale is None else ScaledCapture(recording, scale)


def _model(tree: FileTree) -> tuple[str, str] | None:
    """Folder of the model and whether it is .bin or .txt; that of a workspace with depth maps first."""
    dense = [w for w in WORKSPACES if any(n.startswith(f"{w}stereo/depth_maps/") for n in tree.names)]
    for folder in (*(w + "sparse/" for w in dense), *MODELS):
        for kind in (".bin", ".txt"):
            if all(f"{folder}{part}{kind}" in tree for part in PARTS):
                return folder, kind
    return None


def _read_model(tree: FileTree, folder: str, kind: str) -> Any:
    """The model, read by pycolmap from a copy of its three files alone."""
    pycolmap = optional_module("pycolmap", "captures", str(tree.path))
    with tempfile.TemporaryDirectory(prefix="hyjax-") as copy:
        for part in PARTS:
            content = tree.read(f"{folder}{part}{kind}")
            if kind == ".bin":
                check_binary(part, content, tree.where(f"{folder}{part}{kind}"))
            (Path(copy) / f"{part}{kind}").write_bytes(content)
        model = pycolmap.Reconstruction()
        try:
            (model.read_binary if kind == ".bin" else model.read_text)(copy)
            _ = [image.name for image in model.images.values()]  # not UTF-8 in a damaged file
        except Exception as error:  # ValueError, IndexError, MemoryError, …
            reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
            raise InputError(f"{tree.where(folder)}: damaged model ({reason})") from None
    return model


def _pictures(tree: FileTree, top: str) -> dict[str, str]:
    """Names in the model → names in the tree, of all pictures that are there."""
    for folder in (f"{top}images/", f"{top}input/", top):
        inside = [n for n in tree.names if n.startswith(folder) and n.lower().endswith(PICTURES)]
        if folder == top:
            inside = [name for name in inside if "/" not in name.removeprefix(top)]
        if inside:
            return {name.removeprefix(folder): name for name in inside}
    smaller = [f for f in tree.folders() if f.startswith("images_")]
    hint = f"; those of {smaller[0]}/ are smaller than the model's" if smaller else ""
    raise InputError(f"{tree.path}: no pictures of the COLMAP model; looked in {top}images/{hint}")


def _pose(image: Any) -> Float[np.ndarray, "4 4"] | None:
    """Camera-to-world pose; None if it is not a rigid motion."""
    to_camera = np.eye(4)
    to_camera[:3] = image.cam_from_world().matrix()
    exact = rigid(to_camera)
    return None if exact is None else np.linalg.inv(exact)


def _depth_names(tree: FileTree, top: str, chosen: dict[str, Any]) -> dict[str, str]:
    """Depth map by picture: a sensor's, else that of COLMAP's dense reconstruction."""
    for depth_folder in (f"{top}{folder}" for folder in DEPTHS):
        paths = {
            n: f"{depth_folder}/{PurePosixPath(image.name).with_suffix('.png')}" for n, image in chosen.items()
        }
        if found := {name: depth for name, depth in paths.items() if depth in tree}:
            return found
        flat = {name: f"{depth_folder}/{PurePosixPath(name).stem}.png" for name in chosen}
        if len(set(flat.values())) == len(flat) and any(depth in tree for depth in flat.values()):
            return {name: depth for name, depth in flat.items() if depth in tree}
    stereo = {name: f"{top}stereo/depth_maps/{image.name}.geometric.bin" for name, image in chosen.items()}
    return {name: depth for name, depth in stereo.items() if depth in tree}


def _shot(tree: FileTree, image: Any, name: str, short: str, index: int, depth: str | None) -> Shot:
    pose = _pose(image)
    assert pose is not None
    intrinsics, distortion = _lens(image.camera, tree.where(name))
    reader = None
    if depth is not None:
        reader = functools.partial(_read_depth, tree, depth)
    colour = functools.partial(tree_colour, tree, name)
    return Shot(short, float(index), pose, intrinsics, colour, reader, distortion=distortion)


def _lens(camera: Any, where: str) -> tuple[Intrinsics, Distortion | None]:
    model = camera.model_name
    if model not in LENSES:
        raise InputError(f"{where}: camera model {model} is not read, only {', '.join(LENSES)}; undistort it first")
    names, kind = LENSES[model]
    values = dict(zip(names.split(), map(float, camera.params)))
    fx, fy = values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))
    radial = tuple(values.get(f"k{i}", 0.0) for i in range(1, 7 if kind == "brown" else 5))
    try:
        intrinsics = Intrinsics(int(camera.width), int(camera.height), fx, fy, values["cx"], values["cy"])
        if kind == "fisheye":
            return intrinsics, Distortion("fisheye", radial)
        distortion = Distortion("brown", radial, (values.get("p1", 0.0), values.get("p2", 0.0)))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return intrinsics, None if distortion.is_none else distortion


def _read_depth(tree: FileTree, name: str) -> DepthAndConfidence:
    if name.endswith(".bin"):
        depth = read_array(tree.read(name), tree.where(name))
        return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32), None
    return tree_depth(tree, name), None


def _scale(model: Any, chosen: dict[str, Any], shots: list[Shot]) -> tuple[float | None, str]:
    """Metres in a unit of the model, by a sensor's depth at its sparse points, and a remark that says so."""
    ratios: list[Float[np.ndarray, n]] = []
    for shot, image in spread(
        [pair for pair in zip(shots, chosen.values()) if pair[0].depth], MOST_MEASURED_PICTURES
    ):
        seen = [p.point3D_id for p in image.points2D if p.has_point3D() and model.exists_point3D(p.point3D_id)]
        if not seen or shot.depth is None:
            continue
        try:
            depth, _ = shot.depth()
        except InputError:  # damaged within; whoever reads it is told
            continue
        points = np.array([model.points3D[number].xyz for number in seen])
        pixel, far = Camera(shot.intrinsics.resize(*depth.shape), shot.pose).project(points)
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel >= 0) & (pixel < depth.shape[::-1]), axis=1) & (far > 0)
        column, row = pixel[inside].astype(int).T
        read = depth[row, column]
        ratios.append((read / far[inside])[read > 0])
    every = np.concatenate(ratios) if ratios else np.zeros(0)
    if len(every) < FEWEST_POINTS:
        return None, f"the depth maps meet {len(every)} sparse points, too few of them to tell the scale"
    scale = float(np.median(every))
    off = float(np.median(np.abs(every / scale - 1)))
    return scale, f"{scale:.4g} m in a unit by {len(every)} sparse points, half of them within {off:.1%}"


FORMAT = CaptureFormat("COLMAP", is_colmap, open_colmap, "sparse/0/cameras.bin|txt, images/")
