"""Directions in a room, and where a click or a drawn rectangle puts things."""

import math

import numpy as np
import pytest
from extras import need
from hypothesis import given
from hypothesis import strategies as st

need("tour")

from hyjax.light.kinds import Aperture
from hyjax.tour.placement import compass, draw_window, north_for_bearing, place_window, unit
from hyjax.tour.plan import Window
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([0.5, 3.0, 1.6])
WALL = Window((0.4, 0.0, 1.5), (0.0, 1.0, 0.0), 1.2, 0.8)  # in the wall at y = 0


@given(st.floats(0, 360), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_the_compass_is_a_rotation(north: float, up: tuple[float, float, float]) -> None:
    rows = compass(north, np.asarray(up))
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rows) == pytest.approx(1)


@given(st.floats(0, 359), st.floats(0, 6.28))
def test_a_window_faces_where_it_is_told_to(bearing: float, angle: float) -> None:
    window = Window((0.0, 0.0, 1.0), (math.cos(angle), math.sin(angle), 0.0))
    east, north, _ = compass(north_for_bearing(window, bearing, UP), UP)
    out = -np.asarray(window.normal)
    found = math.degrees(math.atan2(out @ east, out @ north))
    assert abs((found - bearing + 180) % 360 - 180) < 1e-6


def test_a_window_on_a_crooked_wall_stands_upright() -> None:
    window = place_window(np.zeros(3), np.array([0.98, 0.0, 0.2]), UP)
    assert window.normal == pytest.approx((1.0, 0.0, 0.0))


def corners_of(window: Window) -> np.ndarray:
    """Top left, top right, bottom right and bottom left, seen from inside."""
    opening = Aperture.facing(window.center, window.normal, UP, window.width, window.height)
    x, y = np.asarray(opening.right, float), np.asarray(opening.up, float)
    return np.asarray(window.center) + np.stack([y - x, y + x, x - y, -x - y])


def surface(window: Window, count: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Points of the wall all over a window, and their normals."""
    a, b, _, d = corners_of(window)
    s, t = (x.reshape(-1, 1) for x in np.meshgrid(*[np.linspace(0, 1, count)] * 2))
    points = a + s * (b - a) + t * (d - a)
    return points, np.broadcast_to(np.asarray(window.normal), points.shape)


def drawn(window: Window, points: np.ndarray, normals: np.ndarray, eye: np.ndarray = EYE) -> Window:
    return draw_window(eye, corners_of(window) - eye, points, normals, UP)


@given(
    st.floats(0, 2 * math.pi), st.floats(0.3, 2.5), st.floats(0.3, 2.5), st.floats(-1.2, 1.2), st.floats(0.5, 5.0)
)
def test_a_window_is_where_it_was_drawn(turn: float, width: float, height: float, side: float, far: float) -> None:
    normal = np.array([math.cos(turn), math.sin(turn), 0.0])
    window = Window((0.3, -0.2, 1.4), tuple(normal.tolist()), width, height)
    eye = np.asarray(window.center) + far * (normal + math.tan(side) * np.cross(UP, normal)) + 0.3 * UP
    found = drawn(window, *surface(window), eye=eye)
    assert (found.width, found.height) == pytest.approx((width, height), abs=0.15 / math.cos(side))
    assert found.center == pytest.approx(window.center, abs=0.1 / math.cos(side))
    assert found.normal == pytest.approx(window.normal)


@pytest.mark.parametrize("turn", range(4))
def test_a_camera_may_be_held_sideways(turn: int) -> None:
    corners = np.roll(corners_of(WALL), turn, axis=0) - EYE
    found = draw_window(EYE, corners, *surface(WALL), UP)
    assert (found.width, found.height) == pytest.approx((WALL.width, WALL.height), abs=0.02)
    assert found.center == pytest.approx(WALL.center, abs=0.03)


def test_a_hole_in_the_wall_and_a_chair_before_it_do_not_matter() -> None:
    points, normals = surface(WALL)
    frame = np.abs(points - np.asarray(WALL.center)).max(axis=1) > 0.35
    chair = points[~frame][:6] + np.array([0.0, 1.0, 0.0])
    sideways = np.broadcast_to([1.0, 0.0, 0.0], chair.shape)
    found = drawn(WALL, np.concatenate([points[frame], chair]), np.concatenate([normals[frame], sideways]))
    assert found.center == pytest.approx(WALL.center, abs=0.03) and found.normal == WALL.normal


def test_what_is_no_window_is_refused() -> None:
    points, normals = surface(WALL)
    with pytest.raises(InputError, match="no surface"):
        drawn(WALL, points[:0], normals[:0])
    with pytest.raises(InputError, match="from the side"):
        drawn(WALL, points, normals, eye=np.array([4.0, -0.5, 1.5]))
    small = Window(WALL.center, WALL.normal, 0.04, 0.04)
    with pytest.raises(InputError, match="too small"):
        drawn(small, *surface(small))


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_upright_is_across_and_nearest_to_up(vector: tuple[float, float, float]) -> None:
    normal = unit(vector)
    high = np.asarray(Aperture.facing(np.zeros(3), normal, UP, 2.0, 2.0).up, float)
    assert np.linalg.norm(high) == pytest.approx(1) and abs(high @ normal) < 1e-6 and high @ UP > -1e-6
