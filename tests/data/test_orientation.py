"""Turning pictures upright: every pixel keeps its colour, its depth and its ray."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Frame
from hyjax.data.orientation import turn_frame, turn_picture, turns_upright
from hyjax.geometry.camera import Camera, Intrinsics, look_at

UP = np.array([0.0, 0.0, 1.0])


def random_frame(seed: int) -> Frame:
    """Odd sizes, unequal focal lengths, a principal point off the centre, depth of another size."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 9, 2)
    lens = Intrinsics(int(width), int(height), *rng.uniform(3, 9, 2), *rng.uniform(0, 9, 2))
    depth_lens = Intrinsics(5, 3, *rng.uniform(3, 9, 2), *rng.uniform(0, 5, 2))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    image, depth = rng.uniform(size=(height, width, 3)), rng.uniform(1, 4, (3, 5))
    return Frame("a", image, Camera(lens, pose), 0.0, depth, depth_lens)


@given(st.integers(0, 10**6), st.integers(-5, 9))
def test_the_world_does_not_move(seed: int, quarters: int) -> None:
    frame = random_frame(seed)
    turned = turn_frame(frame, quarters)
    points = frame.depth_camera.unproject(frame.depth)
    np.testing.assert_allclose(
        turned.depth_camera.unproject(turned.depth), turn_picture(points, quarters), atol=1e-9
    )
    np.testing.assert_allclose(turned.camera.rays(), turn_picture(frame.camera.rays(), quarters), atol=1e-9)
    np.testing.assert_array_equal(turned.image, turn_picture(frame.image, quarters))


@given(st.integers(0, 10**6), st.integers(-5, 9))
def test_turning_back_gives_the_frame_again(seed: int, quarters: int) -> None:
    frame = random_frame(seed)
    again = turn_frame(turn_frame(frame, quarters), -quarters)
    np.testing.assert_array_equal(again.image, frame.image)
    np.testing.assert_array_equal(again.depth, frame.depth)
    np.testing.assert_allclose(again.camera.pose, frame.camera.pose, atol=1e-12)
    for lens, before in (
        (again.camera.intrinsics, frame.camera.intrinsics),
        (again.depth_intrinsics, frame.depth_intrinsics),
    ):
        assert lens.shape == before.shape
        np.testing.assert_allclose(lens.matrix, before.matrix, atol=1e-12)


def test_turns_are_clockwise() -> None:
    picture = np.array([[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(turn_picture(picture, 1), [[4, 1], [5, 2], [6, 3]])


@pytest.mark.parametrize("quarters", range(4))
def test_a_device_held_any_way_round_is_turned_upright(quarters: int) -> None:
    lens = Intrinsics(8, 6, 8.0, 8.0, 4.0, 3.0)
    targets = np.random.default_rng(0).normal(size=(9, 3)) * (1, 1, 0.4)
    poses = [Camera(lens, look_at(np.zeros(3), t, UP)).turned(-quarters).pose for t in targets]
    assert turns_upright(poses) == quarters
    # In the picture that comes out, world-up points up.
    assert all(Camera(lens, pose).turned(turns_upright(poses)).pose[2, 1] < -0.5 for pose in poses)


@pytest.mark.parametrize(
    ("third_row", "quarters"), [((0, -1), 0), ((-1, 0), 1), ((0, 1), 2), ((1, 0), 3), ((-0.6, -0.5), 1)]
)
def test_orientation_by_the_published_rule(third_row: tuple[float, float], quarters: int) -> None:
    """World-z along the camera's x and y: nearest of up, a turn clockwise, half a turn, a turn back."""
    pose = np.eye(4)
    pose[2, :2] = third_row
    assert turns_upright([pose]) == quarters


def test_the_majority_decides() -> None:
    upright = look_at(np.zeros(3), np.array([1.0, 0, 0]), UP)
    sideways = Camera(Intrinsics(2, 2, 1, 1, 1, 1), upright).turned(1).pose
    assert turns_upright([upright, sideways, sideways]) == turns_upright([sideways]) == 3
    assert turns_upright([upright, sideways, upright]) == 0
