"""Trajectories: inverted once, interpolated between poses, never beyond them."""

from pathlib import Path

import numpy as np
import pytest
import refusals
from hypothesis import given
from hypothesis import strategies as st
from reference.arkit_export import write_trajectory
from scipy.spatial.transform import Rotation

from hyjax.data.trajectory import LARGEST_GAP, Trajectory, read_trajectory
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import check_pose, look_at
from hyjax.util.errors import InputError

ROW = "{} 0.1 0.2 0.3 1 2 3"


def read(path: Path) -> Trajectory:
    return read_trajectory(open_tree(path), path.name)


def refuses(path: Path, *parts: str) -> None:
    refusals.refuses(lambda: read(path), str(path), *parts)


def evenly(turning: np.ndarray, moving: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Poses of a motion with constant velocities."""
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(times[:, None] * turning).as_matrix()
    poses[:, :3, 3] = times[:, None] * moving
    return poses


def test_rows_are_world_to_camera(tmp_path: Path) -> None:
    """A quarter turn about z takes x to y; the camera sits where the motion sends the origin's preimage."""
    file = tmp_path / "a.traj"
    file.write_text(f"10.0 0 0 {np.pi / 2:.12f} 1 2 3\n10.1 0 0 0 1 2 3\n")
    trajectory = read(file)
    turned, straight = trajectory.pose_at(10.0), trajectory.pose_at(10.1)
    np.testing.assert_allclose(straight[:3, 3], [-1, -2, -3])
    np.testing.assert_allclose(turned[:3, 3], [-2, 1, -3], atol=1e-9)
    # Whatever the camera's centre is, the row's motion must send it to the camera's origin.
    sent = Rotation.from_rotvec([0, 0, np.pi / 2]).apply(turned[:3, 3]) + np.array([1, 2, 3])
    np.testing.assert_allclose(sent, 0, atol=1e-9)
    np.testing.assert_allclose(turned[:3, :3] @ [0, 1, 0], [1, 0, 0], atol=1e-9)


def test_the_exports_poses_come_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    times = np.array([7.0, 7.2, 7.25, 8.9])
    poses = np.array([look_at(rng.normal(size=3), rng.normal(size=3), np.array([0, 0, 1.0])) for _ in times])
    write_trajectory(tmp_path / "a.traj", times, poses)
    trajectory = read(tmp_path / "a.traj")
    assert not np.isin(times, trajectory.times).any() and np.diff(trajectory.times).max() < 0.1001
    for time, pose in zip(times, poses):
        np.testing.assert_allclose(trajectory.pose_at(time), pose, atol=1e-7)


@given(st.integers(0, 10**6))
def test_even_motion_is_interpolated_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turning, moving = rng.uniform(-3, 3, 3), rng.normal(size=3)
    times = np.cumsum(rng.uniform(0.01, LARGEST_GAP, 6))
    trajectory = Trajectory(times, evenly(turning, moving, times))
    for time in rng.uniform(times[0], times[-1], 5):
        pose = trajectory.pose_at(time)
        check_pose(pose)
        np.testing.assert_allclose(pose, evenly(turning, moving, np.array([time]))[0], atol=1e-9)


def test_times_beyond_the_poses_are_not_covered() -> None:
    times = np.array([1.0, 1.1, 1.2])
    trajectory = Trajectory(times, evenly(np.ones(3), np.ones(3), times), "a.traj")
    assert all(trajectory.covers(time) for time in (1.0, 1.05, 1.1, 1.2))
    for time in (0.0, 0.9999, 1.2001, 9.0, np.nan):
        assert not trajectory.covers(time)
        with pytest.raises(InputError, match=r"a\.traj: no pose at .* 1\.000 to 1\.200 s"):
            trajectory.pose_at(time)


def test_wide_gaps_are_not_bridged() -> None:
    times = np.array([1.0, 1.0 + LARGEST_GAP, 2.1, 2.2])
    trajectory = Trajectory(times, evenly(np.ones(3), np.ones(3), times))
    assert [trajectory.covers(t) for t in (1.2, 1.5, 1.51, 1.8, 2.09, 2.1, 2.15)] == [
        *(True, True, False, False, False, True, True)
    ]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "empty"),
        ("\n \n", "empty"),
        (ROW.format(1.0), "has 1 pose"),
        (f"{ROW.format(1.0)}\n1.1 0 0 0 1 2\n", "row 2 is not seven finite numbers"),
        (f"{ROW.format(1.0)} 9\n{ROW.format(1.1)}", "row 1 is not seven finite numbers"),
        (f"{ROW.format(1.0)}\n{ROW.format(1.1)}\n1.2 0 x 0 1 2 3", "row 3 is not seven finite numbers"),
        (f"{ROW.format(1.0)}\n1.1 0 nan 0 1 2 3", "row 2 is not seven finite numbers"),
        (f"{ROW.format(1.0)}\n1.1 0 1e15 0 1 2 3", "turns by 1e+15 radians"),
        (f"{ROW.format(1.0)}\n{ROW.format('inf')}", "row 2 is not seven finite numbers"),
        (f"{ROW.format(1.0)}\n\n{ROW.format(1.1)}", "row 2 is not seven finite numbers"),
        ("\n".join(map(ROW.format, (1.0, 1.2, 1.1, 1.3))), "row 3: time 1.1 is before that of the row above, 1.2"),
        ("\n".join(map(ROW.format, (1.0, 1.2, 1.2, 1.3))), "row 3: time 1.2 is the same as that of the row above"),
    ],
)
def test_bad_files_are_one_line(tmp_path: Path, content: str, problem: str) -> None:
    file = tmp_path / "lowres_wide.traj"
    file.write_text(content)
    refuses(file, problem)


def test_files_that_are_not_text(tmp_path: Path) -> None:
    (tmp_path / "a.traj").write_bytes(bytes(range(128, 256)))
    refuses(tmp_path / "a.traj", "not a text file")


def test_blank_lines_at_the_end_are_no_rows(tmp_path: Path) -> None:
    (tmp_path / "a.traj").write_text("\n".join(map(ROW.format, (1.0, 1.1))) + "\n\n")
    assert len(read(tmp_path / "a.traj").times) == 2
