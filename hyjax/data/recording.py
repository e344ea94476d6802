"""Recordings: captures that are a list of shots, each a posed picture, a posed depth map, or both.

A reader of a format only makes `Shot`s; everything that formats have in common is done here: lens distortion is
undone, sizes are checked, pictures are turned upright, shots without a picture still give their depth to fusion.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import MARGIN_DEPTH, Capture, Frame
from hyjax.data.capture_files import tree_depth
from hyjax.data.file_tree import FileTree
from hyjax.data.lens import Distortion, undistorted
from hyjax.data.orientation import turn_frame, turns_upright
from hyjax.geometry.camera import LARGEST_DISTANCE, Camera, Intrinsics, check_pose
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import UNKNOWN, DepthSensor
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    import trimesh

Y_UP, Z_UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
MOST_METRES = 1e5
"""Metres from the world's origin beyond which a camera's position is taken for garbage."""
MARGIN_WHITE, MARGIN_SHARE = 0.92, 0.95
"""Least value of a white margin's pixels, and their least share in its lines."""
AXIS_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

DepthAndConfidence = tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"] | None]


@dataclasses.dataclass(frozen=True)
class Shot:
    """Sample of a recording: picture, depth and camera of one moment.

    Attributes:
        name: short and unique within the recording.
        time: seconds.
        pose: camera-to-world in our axes (x right, y down, z forward), metres.
        intrinsics: of the picture as it is stored.
        picture: reads the display-encoded picture; None if there is none.
        depth: reads depth in metres (0 where there is none) and its confidence in [0, 1]; None if there is none.
        depth_intrinsics: of the depth map as it is stored; the picture's, brought to the map's size, if None.
        depth_distortion: of the lens of the depth map; None where it is free of any, as most are.
        exposure: seconds; None where it is not told.
    """

    name: str
    time: float
    pose: Float[np.ndarray, "4 4"]
    intrinsics: Intrinsics
    picture: Callable[[], Float[np.ndarray, "h w 3"]] | None = None
    depth: Callable[[], DepthAndConfidence] | None = None
    depth_intrinsics: Intrinsics | None = None
    distortion: Distortion | None = None
    depth_distortion: Distortion | None = None
    exposure: float | None = None


class Recording(Capture):
    """A capture made of shots, in the order in which they are given.

    Args:
        shots: at least one with a picture.
        name: short; the tree's name if None.
        up: unit vector against gravity; the cameras' mean up direction if None.
        mesh: name of the file of the device's mesh in `tree`; None without one.
        turn: whether pictures are turned upright by quarter turns, all by the same.
    """

    def __init__(
        self,
        tree: FileTree,
        shots: Sequence[Shot],
        *,
        name: str | None = None,
        up: Float[np.ndarray, "3"] | None = None,
        mesh: str | None = None,
        sensor: DepthSensor = UNKNOWN,
        faults: Sequence[str] = (),
        remarks: Sequence[str] = (),
        turn: bool = True,
        metric: bool = True,
        depth_in_units: bool = False,
        times_known: bool = True,
    ) -> None:
        self.name = name or (tree.path.resolve().stem if tree.path.is_file() else tree.path.resolve().name)
        self._tree, self._mesh_name = tree, mesh
        self._mesh: trimesh.Trimesh | None = None
        self._pictures = [shot for shot in shots if shot.picture is not None]
        self._depths = [shot for shot in shots if shot.depth is not None]
        self._depth_times = np.array([shot.time for shot in self._depths])
        if not self._pictures:
            because = f" ({'; '.join(faults)})" if faults else ""
            what = f"none of {len(shots)} frames has a picture that can be read" if shots else "no frame is usable"
            raise InputError(f"{tree.path}: {what}{because}")
        if len({shot.name for shot in self._pictures}) < len(self._pictures):
            raise InputError(f"{tree.path}: two frames have one name")
        for shot in shots:
            check_pose(shot.pose, f"{tree.path}: frame {shot.name}")
        poses = [shot.pose for shot in self._pictures]
        self.up = mean_up(poses, tree.path) if up is None else up
        self.sensor, self.metric = sensor, metric
        self.depth_in_units, self.times_known = depth_in_units, times_known
        self.faults, self.remarks = tuple(faults), tuple(remarks)
        self.quarter_turns = turns_upright(poses, self.up) if turn else 0
        self.mesh_file = None if mesh is None else Path(tree.where(mesh))

    @property
    def fingerprint(self) -> str:
        return self._tree.fingerprint()

    def __len__(self) -> int:
        return len(self._pictures)

    def __getitem__(self, index: int) -> Frame:
        """The frame at a position; IndexError beyond the end ends a `for` loop."""
        frame, shot = self._read_picture(index), self._pictures[index]
        if shot.depth is not None:
            depth, confidence, lens = _read_depth(shot)
            own = None if lens == shot.intrinsics else lens
            frame = dataclasses.replace(frame, depth=depth, depth_intrinsics=own, confidence=confidence)
        return turn_frame(frame, self.quarter_turns)

    def picture(self, index: int) -> Frame:
        """See `Capture`."""
        return turn_frame(self._read_picture(index), self.quarter_turns)

    def _read_picture(self, index: int) -> Frame:
        """A frame as the device held it, without depth."""
        shot = self._pictures[index]
        assert shot.picture is not None
        image = without_margin(shot.picture())
        intrinsics = shot.intrinsics
        if image.shape[:2] != intrinsics.shape:
            raise InputError(
                f"{self.name}: picture of frame {shot.name} is {image.shape[1]}x{image.shape[0]} but its "
                f"intrinsics are for {intrinsics.width}x{intrinsics.height}"
            )
        if shot.distortion is not None:
            image = undistorted(image, intrinsics, shot.distortion)
        time = shot.time - self._pictures[0].time
        return Frame(shot.name, image, Camera(intrinsics, shot.pose), time, exposure=shot.exposure)

    def camera(self, index: int) -> Camera:
        shot = self._pictures[index]
        return Camera(shot.intrinsics, shot.pose).turned(self.quarter_turns)

    @property
    def depth_count(self) -> int:
        return len(self._depths)

    def depth_position(self, index: int) -> float:
        return float(np.interp(self._pictures[index].time, self._depth_times, np.arange(len(self._depths))))

    def depth_reading(self, index: int) -> DepthReading:
        shot = self._depths[index]
        depth, confidence, lens = _read_depth(shot)
        return DepthReading(depth, Camera(lens, shot.pose), confidence)

    def mesh(self) -> "trimesh.Trimesh | None":
        """See `Capture`; read once."""
        if self._mesh is None and self._mesh_name is not None:
            from hyjax.geometry.mesh import load_mesh  # trimesh is slow to load

            self._mesh = load_mesh(Path(self._mesh_name), repair=True, content=self._tree.read(self._mesh_name))
        return self._mesh


def without_margin(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Picture whose narrow white margin, if it has one on all four sides, is black: no light brightens that.

    NYU's pictures have one, where the lens' distortion was undone. Its innermost lines may be white in part.
    """
    edges = image[0], image[-1], image[:, 0], image[:, -1]
    if any((edge >= MARGIN_WHITE).all(axis=-1).mean() < MARGIN_SHARE for edge in edges):
        return image  # most pictures, at once
    white = (image >= MARGIN_WHITE).all(axis=-1)
    margin = np.zeros_like(white)
    for side in range(4):
        turned = np.rot90(white, side)
        whole = turned.mean(axis=1) >= MARGIN_SHARE
        depth = int(np.argmin(whole))  # of lines from the edge; 0 where all are white, too
        if not 0 < depth <= max(1, MARGIN_DEPTH * len(whole)):
            return image
        np.rot90(margin, side)[: depth + 1] = True
    return np.where((margin & white)[..., None], np.float32(0.0), image)


def _read_depth(
    shot: Shot,
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"] | None, Intrinsics]:
    """A shot's depth map and its confidence as a pinhole would have them, and their intrinsics."""
    assert shot.depth is not None
    depth, confidence = shot.depth()
    lens = _depth_lens(shot, depth)
    if shot.depth_distortion is not None:
        depth = undistorted(depth, lens, shot.depth_distortion, nearest=True)
        if confidence is not None:
            confidence = undistorted(confidence, lens, shot.depth_distortion, nearest=True)
    return depth, confidence, lens


def _depth_lens(shot: Shot, depth: Float[np.ndarray, "h w"]) -> Intrinsics:
    lens = shot.depth_intrinsics
    if lens is None:
        return shot.intrinsics.resize(*depth.shape)
    if lens.shape != depth.shape:
        raise InputError(
            f"depth map of frame {shot.name} is {depth.shape[1]}x{depth.shape[0]} but its intrinsics are for "
            f"{lens.width}x{lens.height}"
        )
    return lens


def depth_reader(tree: FileTree, name: str, unit: float = 0.001) -> Callable[[], DepthAndConfidence]:
    """Reads a depth map without confidence; see `tree_depth`."""
    return lambda: (tree_depth(tree, name, unit), None)


def from_opengl(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world in our axes from one whose camera looks along -z with y up, as ARKit's and OpenGL's do.

    It is its own inverse.

    Example:
        >>> import numpy as np
        >>> from_opengl(np.eye(4))[:3, 2]
        array([ 0.,  0., -1.])
    """
    return np.asarray(pose, np.float64) @ AXIS_FLIP


def mean_up(poses: Sequence[Float[np.ndarray, "4 4"]], where: Path | str) -> Float[np.ndarray, "3"]:
    """Unit mean of the cameras' up directions."""
    up = -np.mean([pose[:3, 1] for pose in poses], axis=0)
    length = float(np.linalg.norm(up))
    if not length > 0.1:
        raise InputError(f"{where}: the cameras' up directions cancel out, so gravity is unknown")
    return up / length


def rigid(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
    """Rigid motion nearest to a rounded pose; None if it is invalid (NaN, infinite, mirrored, scaled)."""
    pose = np.asarray(pose, np.float64)
    if pose.shape != (4, 4) or not np.abs(pose).max() <= LARGEST_DISTANCE:
        return None
    if not np.allclose(pose[3], (0, 0, 0, 1), atol=1e-3):
        return None
    left, scale, right = np.linalg.svd(pose[:3, :3])
    if np.abs(scale - 1.0).max() > 0.01 or np.linalg.det(left @ right) < 0:
        return None
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = left @ right, pose[:3, 3]
    return result


def usable_pose(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
    """Rigid motion nearest to a pose; None if the pose is invalid or leads out of any building."""
    result = rigid(pose)
    return None if result is None or np.abs(result[:3, 3]).max() > MOST_METRES else result


def pose_from_quaternion(
    quaternion: Float[np.ndarray, "4"], position: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"] | None:
    """A pose from a unit quaternion x y z w and a position; None if they are not finite or not of unit length."""
    if not np.abs((*quaternion, *position)).max() < 1e16 or abs(np.linalg.norm(quaternion) - 1.0) > 0.01:
        return None
    pose = np.eye(4)
    from scipy.spatial.transform import Rotation  # SciPy is slow to load

    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = position
    return usable_pose(pose)
