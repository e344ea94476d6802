"""ARKitScenes scans as Apple publishes them, the raw data set or the 3dod one.

    <video_id>/                                   raw: all of it in here
        <video_id>_3dod_mesh.ply                  ARKit's mesh
        lowres_wide.traj                          see `hyjax.data.trajectory`
        vga_wide/<video_id>_<timestamp>.png       640×480 at 30 a second; also lowres_wide/ (256×192 at 60) and,
                                                  of some scans, wide/ (1920×1440 at 10)
        vga_wide_intrinsics/….pincam              width height fx fy cx cy, pixels
        lowres_depth/….png                        16-bit millimetres, seen through lowres_wide's lens
        confidence/….png                          8-bit, 0 low to 2 high
        <video_id>_frames/                        3dod: the folders and the trajectory are in here
                                                  (an older sample has color.traj, wide/, color_intrinsics/ and
                                                  depth_densified/ instead, with files named <timestamp>.png)

The world is z-up, in metres; cameras look along +z with x right and y down. Devices were held in any
orientation: pictures are turned upright (`hyjax.data.orientation`), as the poses say.

Tested on small files written to these layouts, on no real scan.

Source: Baruch et al., "ARKitScenes: a diverse real-world dataset for 3D indoor scene understanding using mobile
RGB-D data", NeurIPS Datasets and Benchmarks 2021, and the data pages of its repository.
"""

import dataclasses
import functools
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hyjax.data.arkit_laser import laser_folder
from hyjax.data.capture import CaptureFormat
from hyjax.data.capture_files import TimedFiles, intrinsics_at, timed_files, tree_colour, tree_numbers
from hyjax.data.file_tree import FileTree
from hyjax.data.phone_captures import PhoneScan
from hyjax.data.recording import Z_UP, DepthAndConfidence, Recording, Shot
from hyjax.data.trajectory import read_trajectory
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Names within a scan.

    Attributes:
        trajectory: file of the poses.
        pictures: folders of pictures, best first.
        intrinsics: folder of their intrinsics; that of the pictures with `_intrinsics` behind it if None.
        depth: folder of depth maps.
        depth_intrinsics: folder of theirs; None if depth is seen through the pictures' lens, whatever its size.
    """

    trajectory: str
    pictures: tuple[str, ...]
    intrinsics: str | None
    depth: str
    depth_intrinsics: str | None


# `wide` is larger than `vga_wide`, but has few pictures of few scans.
PUBLISHED_LAYOUT = _Layout(
    "lowres_wide.traj", ("vga_wide", "wide", "lowres_wide"), None, "lowres_depth", "lowres_wide_intrinsics"
)
OLDER_LAYOUT = _Layout("color.traj", ("wide",), "color_intrinsics", "depth_densified", None)
CONFIDENCE = "confidence"
SIGNS = re.compile(
    r"(lowres_wide\.traj|color\.traj|[0-9]\w*_3dod_mesh\.ply|"
    r"(vga_wide|lowres_wide|lowres_depth|depth_densified|[0-9]\w*_frames)/.*)"
)
"""Names of which any makes a scan."""
PINCAM = "width height fx fy cx cy"
NAME_TOLERANCE = 0.001 + 1e-6
"""Seconds by which the times in the names of a picture and of its `.pincam` may differ: one unit of the last of
three decimals, and what rounding adds to it."""
DEPTH_TOLERANCE = 1 / 60
"""Seconds between a picture and the depth map that goes with it; depth comes sixty times a second."""
TIMED_BY_VIDEO = re.compile(r"(\d+)_")


def is_arkit_scenes(tree: FileTree) -> bool:
    """Whether names alone make it a scan."""
    return any(map(SIGNS.fullmatch, tree.names))


def open_arkit_scenes(tree: FileTree) -> Recording:
    """Open one scan. Trajectory, intrinsics and file names are read and checked now, pictures when asked for.

    Pictures whose time the trajectory does not cover, or that lack intrinsics or depth, are left out with a line.
    """
    if tree.path.is_dir() and (folder := tree.folder).name.endswith("_frames"):  # the mesh lies above
        tree = open_tree(folder.parent)
    scan = PhoneScan(tree)
    assets = next((f"{name}/" for name in tree.folders() if re.fullmatch(r"[0-9].*_frames", name)), "")
    layout = OLDER_LAYOUT if assets + OLDER_LAYOUT.trajectory in tree else PUBLISHED_LAYOUT
    if assets + layout.trajectory not in tree:
        raise InputError(f"{_missing(tree, assets, layout.trajectory)}; about two dozen videos have none")
    trajectory = read_trajectory(tree, assets + layout.trajectory)
    folder_name, lens_folder = _picture_folders(scan, assets, layout)
    pictures, lenses = timed_files(tree, folder_name, ".png"), timed_files(tree, lens_folder, ".pincam")
    depths = _Depths(scan, assets, layout)

    def read(time: float, picture: str) -> Shot | None:
        lens = lenses.nearest(time, NAME_TOLERANCE)
        depth = depths.nearest(time)
        reason = None
        if not trajectory.covers(time):
            reason = f"at times that {layout.trajectory} does not cover"
        elif lens is None:
            reason = "without .pincam"
        elif depth is None and len(depths):
            reason = "without depth or its .pincam"
        if reason is not None or lens is None:
            scan.remarks.add(f"pictures are left out, {reason}", picture)
            return None
        whole = scan.whole(picture, "pictures")
        colour = None if whole is None else functools.partial(tree_colour, tree, whole)
        reader, depth_lens = depth or (None, None)
        pose = trajectory.pose_at(time)
        name, own = Path(picture).stem, read_pincam(tree, lens.name)
        return scan.shot(picture, name, time, pose, own, colour, reader, depth_intrinsics=depth_lens)

    shots = scan.usable([functools.partial(read, *file) for file in pictures])
    if not shots:
        reasons = "; ".join((*scan.faults.lines(), *scan.remarks.lines())) or "the folder is empty"
        raise InputError(f"{tree.where(folder_name)}: none of {len(pictures)} pictures can be used: {reasons}")
    video = TIMED_BY_VIDEO.match(shots[0].name)
    name = video[1] if video else tree.path.resolve().name
    recording = scan.recording(shots, up=Z_UP, mesh=f"{name}_3dod_mesh.ply", name=name)
    if tree.path.is_dir():
        recording.laser_folder = laser_folder(tree.folder, name)
    return recording


def read_pincam(tree: FileTree, name: str) -> Intrinsics:
    """Intrinsics of a `.pincam` file."""
    width, height, *focal_and_centre = (float(value) for value in tree_numbers(tree, name, (6,), PINCAM))
    if not (width.is_integer() and height.is_integer()):
        raise InputError(f"{tree.where(name)}: picture size {width:g}x{height:g} is not whole; need {PINCAM}")
    # cx, cy are taken as they are: Apple counts the principal point from the top left corner of the top left
    # pixel (documentation of AVCameraCalibrationData.intrinsicMatrix), as we do. The loader published with the
    # data has pixel centres at whole numbers instead; the two are half a pixel apart.
    return intrinsics_at(tree.where(name), int(width), int(height), *focal_and_centre)


def _missing(tree: FileTree, assets: str, asset: str) -> InputError:
    return InputError(
        f"{tree.where(assets)}: no {asset}; download asset '{asset}' "
        f"(download_data.py raw --raw_dataset_assets {asset})"
    )


def _picture_folders(scan: PhoneScan, assets: str, layout: _Layout) -> tuple[str, str]:
    """The best folder of pictures that has its intrinsics, and theirs."""
    tree = scan.tree
    pairs = [(name, layout.intrinsics or f"{name}_intrinsics") for name in layout.pictures]
    present = [(pictures, lenses) for pictures, lenses in pairs if tree.below(assets + pictures, ".png")]
    if not present:
        others = f", or one of {', '.join(layout.pictures[1:])}" if layout.pictures[1:] else ""
        raise InputError(f"{_missing(tree, assets, layout.pictures[0])}{others}")
    usable = [pair for pair in present if tree.below(assets + pair[1], ".pincam")]
    if not usable:
        raise _missing(tree, assets, present[0][1])
    if usable[0] != present[0]:
        scan.remarks.add(f"folder of pictures has no {present[0][1]}, {usable[0][0]} is taken", present[0][0])
    return assets + usable[0][0], assets + usable[0][1]


class _Depths:
    """The depth maps of a scan, which have times of their own, and mostly a lens."""

    def __init__(self, scan: PhoneScan, assets: str, layout: _Layout) -> None:
        self._scan = scan
        self._confidences = timed_files(scan.tree, assets + CONFIDENCE, ".png")
        self._lenses: TimedFiles | None = None
        maps = timed_files(scan.tree, assets + layout.depth, ".png")
        if layout.depth_intrinsics is not None and len(maps):
            lenses = self._lenses = timed_files(scan.tree, assets + layout.depth_intrinsics, ".pincam")
            if not len(lenses):
                raise _missing(scan.tree, assets, layout.depth_intrinsics)
            maps = TimedFiles(file for file in maps if lenses.nearest(file.time, NAME_TOLERANCE))
        self._maps = maps

    def __len__(self) -> int:
        return len(self._maps)

    def nearest(self, time: float) -> tuple[Callable[[], DepthAndConfidence] | None, Intrinsics | None] | None:
        """The depth map that goes with a picture, and its lens; None if there is none near it."""
        depth = self._maps.nearest(time, DEPTH_TOLERANCE)
        if depth is None:
            return None
        confidence = self._confidences.nearest(depth.time, NAME_TOLERANCE)
        lens = None if self._lenses is None else self._lenses.nearest(depth.time, NAME_TOLERANCE)
        intrinsics = None if lens is None else read_pincam(self._scan.tree, lens.name)
        read = self._scan.depth(depth.name, confidence and confidence.name)
        return None if read is None else functools.partial(_trusted, read), intrinsics


def _trusted(read: Callable[[], DepthAndConfidence]) -> DepthAndConfidence:
    """Depth and its confidence; 0 where that is low."""
    depth, confidence = read()
    return depth if confidence is None else np.where(confidence > 0, depth, np.float32(0.0)), confidence


FORMAT = CaptureFormat("ARKitScenes", is_arkit_scenes, open_arkit_scenes, "lowres_wide.traj, vga_wide/")
