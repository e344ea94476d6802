"""ARKitScenes' `.traj` files, and a camera's pose at any time in between.

A line a pose, about ten a second: `timestamp rx ry rz tx ty tz`, the motion from world to camera as axis-angle
(radians) and translation (metres). Pictures come at other times than poses.

Source: Baruch et al., "ARKitScenes: a diverse real-world dataset for 3D indoor scene understanding using mobile
RGB-D data", NeurIPS Datasets and Benchmarks 2021, and the data page of its repository.
"""

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import LARGEST_NUMBER
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError

COLUMNS = "timestamp rx ry rz tx ty tz"
LARGEST_GAP = 0.5
"""Seconds between two poses beyond which nothing is known of the way from one to the other."""

LARGEST_TURN = 1000.0
"""Longest valid rotation vector, radians."""


class Trajectory:
    """Camera-to-world poses over time: rotations turn evenly from pose to pose, positions move straight.

    Args:
        times: seconds, ascending.
        poses: camera-to-world, metres.
    """

    def __init__(
        self, times: Float[np.ndarray, "n"], poses: Float[np.ndarray, "n 4 4"], where: str = "trajectory"
    ) -> None:
        if len(times) < 2:
            raise InputError(f"{where}: has {len(times)} pose(s), need at least two to interpolate between")
        for row in np.flatnonzero(np.diff(times) <= 0)[:1] + 1:
            what = "the same as" if times[row] == times[row - 1] else "before"
            raise InputError(
                f"{where}: row {row + 1}: time {times[row]:.10g} is {what} that of the row above, "
                f"{times[row - 1]:.10g}; times must ascend"
            )
        self.times = times
        self._where = where
        self._positions = poses[:, :3, 3]
        from scipy.spatial.transform import Rotation, Slerp  # SciPy is slow to load

        self._rotations = Slerp(times, Rotation.from_matrix(poses[:, :3, :3]))

    def covers(self, time: float) -> bool:
        """Whether `time` lies on a pose, or between two that are at most `LARGEST_GAP` apart."""
        right = int(np.searchsorted(self.times, time))
        if right == len(self.times):
            return False
        if self.times[right] == time:
            return True
        return right > 0 and bool(self.times[right] - self.times[right - 1] <= LARGEST_GAP)

    def pose_at(self, time: float) -> Float[np.ndarray, "4 4"]:
        """The camera-to-world pose at `time`, never extrapolated."""
        if not self.covers(time):
            raise InputError(
                f"{self._where}: no pose at {time:.3f} s; poses run from {self.times[0]:.3f} to "
                f"{self.times[-1]:.3f} s, and gaps over {LARGEST_GAP:g} s are not bridged"
            )
        pose = np.eye(4)
        pose[:3, :3] = self._rotations(time).as_matrix()
        pose[:3, 3] = [np.interp(time, self.times, axis) for axis in self._positions.T]
        return pose


def read_trajectory(tree: FileTree, name: str) -> Trajectory:
    """Read a `.traj` file; its world-to-camera motions are inverted."""
    path, lines = tree.where(name), tree.text(name).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise InputError(f"{path}: empty; need rows of {COLUMNS}")
    rows = np.array([_row(path, number, line) for number, line in enumerate(lines, start=1)])
    if np.abs(rows[:, 1:4]).max() > LARGEST_TURN:
        raise InputError(f"{path}: turns by {np.abs(rows[:, 1:4]).max():.3g} radians; need rows of {COLUMNS}")
    from scipy.spatial.transform import Rotation

    to_world = Rotation.from_rotvec(rows[:, 1:4]).inv()
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = to_world.as_matrix()
    poses[:, :3, 3] = -to_world.apply(rows[:, 4:7])
    return Trajectory(rows[:, 0], poses, path)


def _row(path: str, number: int, line: str) -> list[float]:
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        values = []
    if len(values) != 7 or not np.abs(values).max() <= LARGEST_NUMBER:
        raise InputError(f"{path}: row {number} is not seven finite numbers, {COLUMNS}: {line.strip()[:60]!r}")
    return values
