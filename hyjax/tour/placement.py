"""Directions in a room, and where a click or a drawn rectangle puts things."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.light.kinds import Aperture
from hyjax.scene.light_places import LightAnchors
from hyjax.tour.plan import KINDS, MOST_WINDOWS, SIDE_RANGE, Lamp, LampKind, Point, TourPlan, Window
from hyjax.util.errors import InputError
from hyjax.util.vectors import reject, unit

AFTERNOON = 16.0
"""Hour of a sunny afternoon."""
BEARING = 240.0
"""Bearing of the first window in it, degrees from north: the sun comes in."""
SMALLEST_WINDOW = 0.1
"""Metres: the least width and height of a drawn window."""
WALL_TOLERANCE, WALL_COSINE = 0.1, 0.95
"""Metres from a plane, and the cosine to its normal, up to which a surface belongs to a wall."""


def compass(north: float, up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: east, north and up in world axes."""
    up = unit(up)
    axis = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    x = unit(reject(axis, up))
    angle = math.radians(north)
    to_north = math.cos(angle) * x + math.sin(angle) * np.cross(up, x)
    return np.stack([np.cross(to_north, up), to_north, up])


def north_for_bearing(window: Window, bearing: float, up: Float[np.ndarray, "3"]) -> float:
    """The `north` with which a window looks out towards a compass bearing in degrees (90 is east)."""
    east, north, _ = compass(0.0, up)
    out = -unit(np.asarray(window.normal))
    return (math.degrees(math.atan2(out @ -east, out @ north)) + bearing) % 360.0


def sunny_plan(anchors: LightAnchors) -> TourPlan:
    """Plan of a sunny afternoon, with the windows or the open sky that named set-ups have in a place.

    Windows that are too large or too small for a plan are bounded.
    """
    windows = tuple(
        Window(as_point(w.center), as_point(w.inward), *np.clip([w.width, w.height], *SIDE_RANGE).tolist())
        for w in anchors.windows[:MOST_WINDOWS]
    )
    north = north_for_bearing(windows[0], BEARING, anchors.up)
    shown = () if anchors.open_sky else windows
    return TourPlan(hour=AFTERNOON, windows=shown, open_sky=anchors.open_sky, north=north).check()


def place_lamp(kind: LampKind, point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Lamp:
    """A new lamp on a surface, a little off it, pointing away from it."""
    new = KINDS[kind]
    position = np.asarray(point, float) + new.lift * np.asarray(normal, float)
    return Lamp(kind, as_point(position), as_point(unit(normal)), new.lumen, new.kelvin)


def place_window(
    point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Window:
    """A new window on a wall; on a surface that is nearly upright it is made upright."""
    inward = unit(normal)
    level = reject(inward, up)
    if np.linalg.norm(level) > 0.8:
        inward = unit(level)
    return Window(as_point(np.asarray(point, float) + 0.02 * inward), as_point(inward))


def draw_window(
    origin: Float[np.ndarray, "3"],
    corners: Float[np.ndarray, "4 3"],
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    up: Float[np.ndarray, "3"],
) -> Window:
    """The window for a rectangle that was drawn over a wall.

    The wall is the plane of most of the surface in the rectangle: scans of windows are full of holes, and of what
    stands before them.

    Args:
        corners: rays through its corners, in any order.
    """
    walls = [place_window(point, normal, up) for point, normal in zip(points, normals, strict=True)]
    if not walls:
        raise InputError("there is no surface here; draw a window on a wall")

    def votes(wall: Window) -> int:
        inward = np.asarray(wall.normal)
        near = np.abs((points - np.asarray(wall.center)) @ inward) < WALL_TOLERANCE
        return int((near & (normals @ inward > WALL_COSINE)).sum())

    wall = max(walls, key=votes)
    inward, anchor = np.asarray(wall.normal), np.asarray(wall.center)
    along = corners @ inward
    if (along > -1e-3).any():
        raise InputError("this wall is seen from the side; draw the window from in front of it")
    met = origin + ((anchor - origin) @ inward / along)[:, None] * corners
    axes = Aperture.facing(anchor, inward, up, 2.0, 2.0)
    across, high = np.asarray(axes.right, float), np.asarray(axes.up, float)
    # A rectangle on the screen is none on the wall: edges go half-way between their ends. Cameras may lie sideways.
    left, right = _edges((met - anchor) @ across)
    bottom, top = _edges((met - anchor) @ high)
    width, height = right - left, top - bottom
    if min(width, height) < SMALLEST_WINDOW:
        raise InputError(f"a window of {width:.2f} x {height:.2f} m is too small; draw it larger, or click")
    center = anchor + 0.5 * (left + right) * across + 0.5 * (top + bottom) * high
    return Window(as_point(center), wall.normal, round(width, 3), round(height, 3))


def _edges(places: Float[np.ndarray, "4"]) -> tuple[float, float]:
    low, middle, higher, high = np.sort(places)
    return 0.5 * float(low + middle), 0.5 * float(higher + high)


def as_point(vector: Any) -> Point:
    """A vector as three numbers."""
    x, y, z = (float(v) for v in vector)
    return x, y, z
