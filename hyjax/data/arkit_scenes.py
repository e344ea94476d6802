"""ARKitScenes scans as Apple publishes them, the raw data set or the 3dod one.

    <video_id>/                                   raw: all of it in here
        <video_id>_3dod_mesh.ply                  ARKit's mesh
        lowres_wide.traj                          see `hyjax.data.trajectory`
        vga_wide/<video_id>_<timestamp>.png       640×480 at 30 a second; also lowres_wide/ (256×192 at 60) and,
                                                  of some scans, wide/ (1920×1440 at 10)
        vga_wide_intrinsics/….pincam              see `hyjax.data.arkit_intrinsics`
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
import itertools
import logging
import re
from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.data.arkit_intrinsics import NAME_TOLERANCE, read_intrinsics
from hyjax.data.arkit_laser import laser_folder
from hyjax.data.capture import Capture, CaptureFormat, Frame
from hyjax.data.capture_files import TimedFile, TimedFiles, fingerprint, read_colour, timed_files
from hyjax.data.orientation import turn_frame, turns_upright
from hyjax.data.phone_captures import confidence_from_levels
from hyjax.data.trajectory import Trajectory, read_trajectory
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.util.errors import InputError
from hyjax.util.images import read_depth, read_labels


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Names within a scan.

    Attributes:
        trajectory: file of the poses.
        pictures: folders of pictures, best first.
        intrinsics: folder of their intrinsics; that of the pictures with `_intrinsics` behind it if None.
        depth: folder of depth maps.
        depth_intrinsics: folder of theirs.
        one_lens: whether depth is seen through the pictures' lens, whatever its size.
    """

    trajectory: str
    pictures: tuple[str, ...]
    intrinsics: str | None
    depth: str
    depth_intrinsics: str
    one_lens: bool = False


TRAJECTORY = "lowres_wide.traj"
# `wide` is larger than `vga_wide`, but has few pictures of few scans.
PUBLISHED = _Layout(TRAJECTORY, ("vga_wide", "wide", "lowres_wide"), None, "lowres_depth", "lowres_wide_intrinsics")
OLDER = _Layout("color.traj", ("wide",), "color_intrinsics", "depth_densified", "color_intrinsics", one_lens=True)
CONFIDENCE = "confidence"
DEPTH_TOLERANCE = 1 / 60
"""Seconds between a picture and the depth map that goes with it; depth comes sixty times a second."""
TIMED_BY_VIDEO = re.compile(r"(\d+)_")
_log = logging.getLogger(__name__)


def is_arkit_scenes(path: Path) -> bool:
    """Whether `path` is a scan's folder, or one of the folders above them (which `open_arkit_scenes` refuses)."""
    return _is_scan(path) or bool(_scans_below(path))


def open_arkit_scenes(path: Path) -> "ArkitScenes":
    """Open the folder of one scan. Trajectory and file names are read and checked now, pictures when asked for.

    Pictures whose time the trajectory does not cover, or that lack intrinsics or depth, are left out; one warning
    says how many.

    Raises:
        InputError: no such folder, not the folder of one scan, an asset is missing (it is named as the official
            downloader names it), a malformed trajectory, or no picture is left.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give the folder of a scan, .../<video_id>")
    if not _is_scan(path):
        scans = _scans_below(path)
        hint = f"; give the folder of one, such as {' or '.join(map(str, scans))}" if scans else ""
        raise InputError(f"{path}: not an ARKitScenes scan but a folder of scans{hint}")
    return ArkitScenes(path)


@dataclasses.dataclass(frozen=True)
class _DepthFiles:
    """The files of one depth map."""

    map: Path
    intrinsics: Path
    confidence: Path | None
    one_lens: bool


@dataclasses.dataclass(frozen=True)
class _FrameFiles:
    """The files of one frame."""

    time: float
    picture: Path
    intrinsics: Path
    depth: _DepthFiles | None


class ArkitScenes(Capture):
    """A scan in order of time, upright.

    Attributes:
        name: the video's number.
        up: +z.
        mesh_file: ARKit's mesh of the place; None if it was not downloaded.
        laser_folder: the venue's laser scans (`<id>.ply` with `<id>_pose.txt`); None if they were not downloaded.
        quarter_turns: by how many the pictures on disk are turned clockwise to be upright.
    """

    def __init__(self, path: Path) -> None:
        assets = _assets_folder(path.resolve())
        scan = assets.parent if assets.name.endswith("_frames") else assets
        layout = OLDER if (assets / OLDER.trajectory).is_file() else PUBLISHED
        if not (assets / layout.trajectory).is_file():
            raise InputError(f"{_missing(assets, layout.trajectory)}; about two dozen videos have none")
        trajectory = read_trajectory(assets / layout.trajectory)
        pictures = _picture_folder(assets, layout)
        intrinsics = _intrinsics_folder(pictures, layout)
        depths = _Depths(assets, layout) if (assets / layout.depth).is_dir() else None
        self._scan = scan
        self._folders = {scan, assets, pictures, intrinsics} | (depths.folders if depths else set())
        self._frames = _frames(assets, pictures, intrinsics, depths, trajectory, layout)
        self._poses = [trajectory.pose_at(shot.time) for shot in self._frames]
        self.quarter_turns = turns_upright(self._poses)
        self.up = np.array([0.0, 0.0, 1.0])
        self.sensor = PHONE_LIDAR
        video = TIMED_BY_VIDEO.match(self._frames[0].picture.name)
        self.name = video[1] if video else scan.name
        mesh = scan / f"{self.name}_3dod_mesh.ply"
        self.mesh_file = mesh if mesh.is_file() else None
        self.laser_folder = laser_folder(scan, self.name)

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return fingerprint(self._scan, self._folders)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        """Frame at a position in order of time. IndexError beyond the end ends a `for` loop.

        Depth is 0 where its confidence is low, which is 0 too; medium is 0.5, high is 1.
        """
        shot = self._frames[index]
        image, intrinsics = read_colour(shot.picture), read_intrinsics(shot.intrinsics)
        _check_size(shot.picture, image, intrinsics.shape, shot.intrinsics)
        depth = lens = confidence = None
        if shot.depth is not None:
            depth, lens, confidence = _read_depth(shot.depth)
        time = shot.time - self._frames[0].time
        camera = Camera(intrinsics, self._poses[index])
        frame = Frame(shot.picture.stem, image, camera, time, depth, lens, confidence)
        return turn_frame(frame, self.quarter_turns)

    def camera(self, index: int) -> Camera:
        """See `Capture`."""
        lens = read_intrinsics(self._frames[index].intrinsics)
        return Camera(lens, self._poses[index]).turned(self.quarter_turns)

    @property
    def depth_count(self) -> int:
        """See `Capture`."""
        return len(self) if self._frames[0].depth is not None else 0

    def depth_reading(self, index: int) -> DepthReading:
        """See `Capture`."""
        files = self._frames[index].depth
        if files is None:
            raise InputError(f"{self.name}: has no depth")
        depth, lens, confidence = _read_depth(files)
        return DepthReading(depth, Camera(lens, self._poses[index]), confidence)


def _is_scan(path: Path) -> bool:
    """Whether names alone make it a scan."""
    layouts = (TRAJECTORY, OLDER.trajectory, "vga_wide", "lowres_wide", PUBLISHED.depth, OLDER.depth)
    signs = (*layouts, "[0-9]*_frames", "[0-9]*_3dod_mesh.ply")
    return any(any(path.glob(sign)) for sign in signs)


def _scans_below(path: Path) -> list[Path]:
    """A few scans of a split's folder, a data set's or a download's."""
    candidates = (
        folder
        for above in ("", "Training/", "Validation/", "raw/*/", "3dod/*/")
        for folder in sorted(path.glob(f"{above}[0-9]*"))
    )
    return list(itertools.islice(filter(_is_scan, candidates), 2))


def _assets_folder(path: Path) -> Path:
    """Folder of the trajectory and of the folders of pictures: 3dod has them one level further down."""
    return next((folder for folder in sorted(path.glob("[0-9]*_frames")) if folder.is_dir()), path)


def _missing(assets: Path, asset: str) -> InputError:
    return InputError(
        f"{assets}: no {asset}; download asset '{asset}' (download_data.py raw --raw_dataset_assets {asset})"
    )


def _intrinsics_folder(pictures: Path, layout: _Layout) -> Path:
    return pictures.with_name(layout.intrinsics or f"{pictures.name}_intrinsics")


def _picture_folder(assets: Path, layout: _Layout) -> Path:
    """The best folder of pictures that has its intrinsics."""
    present = [assets / name for name in layout.pictures if (assets / name).is_dir()]
    if not present:
        others = f", or one of {', '.join(layout.pictures[1:])}" if layout.pictures[1:] else ""
        raise InputError(f"{_missing(assets, layout.pictures[0])}{others}")
    usable = [folder for folder in present if _intrinsics_folder(folder, layout).is_dir()]
    missing = _missing(assets, _intrinsics_folder(present[0], layout).name)
    if not usable:
        raise missing
    if usable[0] != present[0]:
        _log.warning("%s; taking the pictures of %s", missing, usable[0].name)
    return usable[0]


class _Depths:
    """The depth maps of a scan, which have a lens and times of their own."""

    def __init__(self, assets: Path, layout: _Layout) -> None:
        maps, intrinsics_files, confidences = (
            assets / name for name in (layout.depth, layout.depth_intrinsics, CONFIDENCE)
        )
        self._one_lens = layout.one_lens
        if not intrinsics_files.is_dir():
            raise _missing(assets, intrinsics_files.name)
        self.folders = {maps, intrinsics_files} | ({confidences} if confidences.is_dir() else set())
        self._intrinsics = timed_files(intrinsics_files, ".pincam")
        self._confidences = timed_files(confidences, ".png")
        self._maps = TimedFiles(file for file in timed_files(maps, ".png") if self._intrinsics_of(file))

    def _intrinsics_of(self, depth: TimedFile) -> TimedFile | None:
        return self._intrinsics.nearest(depth.time, NAME_TOLERANCE)

    def nearest(self, time: float) -> _DepthFiles | None:
        """The depth map with intrinsics that goes with a picture; None if there is none near it."""
        depth = self._maps.nearest(time, DEPTH_TOLERANCE)
        intrinsics_file = depth and self._intrinsics_of(depth)
        if depth is None or intrinsics_file is None:
            return None
        confidence = self._confidences.nearest(depth.time, NAME_TOLERANCE)
        return _DepthFiles(depth.path, intrinsics_file.path, confidence and confidence.path, self._one_lens)


def _frames(
    assets: Path, pictures: Path, intrinsics: Path, depths: _Depths | None, trajectory: Trajectory, layout: _Layout
) -> list[_FrameFiles]:
    """The frames that have all they need; a warning counts the others."""
    files, intrinsics_files = timed_files(pictures, ".png"), timed_files(intrinsics, ".pincam")
    shots: list[_FrameFiles] = []
    left_out: Counter[str] = Counter()
    for time, picture in files:
        intrinsics_file = intrinsics_files.nearest(time, NAME_TOLERANCE)
        depth = None if depths is None else depths.nearest(time)
        if not trajectory.covers(time):
            left_out[f"at times that {layout.trajectory} does not cover"] += 1
        elif intrinsics_file is None:
            left_out["without .pincam"] += 1
        elif depths is not None and depth is None:
            left_out["without depth or its .pincam"] += 1
        else:
            shots.append(_FrameFiles(time, picture, intrinsics_file.path, depth))
    reasons = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
    if not shots:
        raise InputError(
            f"{pictures}: none of {len(files)} pictures can be used: {reasons or 'the folder is empty'}"
        )
    if left_out:
        _log.warning("%s: %d of %d pictures left out: %s", assets, left_out.total(), len(files), reasons)
    return shots


def _read_depth(
    files: _DepthFiles,
) -> tuple[Float[np.ndarray, "h w"], Intrinsics, Float[np.ndarray, "h w"] | None]:
    """Depth in metres, 0 where there is no reading or its confidence is low, its intrinsics and its confidence."""
    depth, intrinsics = read_depth(files.map), read_intrinsics(files.intrinsics)
    if files.one_lens:
        intrinsics = intrinsics.resize(*depth.shape)
    _check_size(files.map, depth, intrinsics.shape, files.intrinsics)
    if files.confidence is None:
        return depth, intrinsics, None
    levels = read_labels(files.confidence)
    _check_size(files.confidence, levels, depth.shape, files.map)
    return np.where(levels == 0, np.float32(0.0), depth), intrinsics, confidence_from_levels(levels)


def _check_size(file: Path, pixels: np.ndarray, shape: tuple[int, ...], other: Path) -> None:
    if pixels.shape[:2] != shape:
        raise InputError(
            f"{file}: is {pixels.shape[1]}x{pixels.shape[0]} but {other.parent.name}/{other.name} is for "
            f"{shape[1]}x{shape[0]}; the two must have one size"
        )


FORMAT = CaptureFormat(
    "ARKitScenes",
    lambda tree: tree.path.is_dir() and is_arkit_scenes(tree.path),
    lambda tree: open_arkit_scenes(tree.folder),
    "lowres_wide.traj, vga_wide/",
)
