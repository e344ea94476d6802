"""Floor plan and tops: rectangles that carry things, and the search for free places on them."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.random_room.builder import RoomBuilder


@dataclasses.dataclass(frozen=True)
class Top:
    """Top: a level rectangle that carries things, in the axes of its furnishing.

    Attributes:
        low, high: its corners (x, y).
        room: free height above it.
        kind: of its things: "things", "shelf" (upright, from the back) or "floor".
    """

    low: tuple[float, float]
    high: tuple[float, float]
    z: float
    room: float
    kind: str = "things"


@dataclasses.dataclass(frozen=True)
class Furnishing:
    """Object to place, standing on z = 0 with its front towards -y and its footprint centred on the origin.

    Attributes:
        wide, deep, tall: of the box around it, in metres.
        add: builds it and returns its tops.
        wall: stands with its back to a wall.
    """

    wide: float
    deep: float
    tall: float
    add: Callable[[RoomBuilder], list[Top]]
    wall: bool = False


class FloorPlan:
    """Occupied parts of a rectangle: turned rectangles that must not overlap."""

    def __init__(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        self.low, self.high = np.array(low), np.array(high)
        self._taken: list[np.ndarray] = []

    def take(self, x: float, y: float, wide: float, deep: float, turn: float) -> bool:
        """Occupy a rectangle turned by `turn` degrees about its centre, if it is free and inside."""
        corners = footprint(x, y, wide, deep, turn)
        if (corners < self.low - 1e-9).any() or (corners > self.high + 1e-9).any():
            return False
        if any(overlap(corners, other) for other in self._taken):
            return False
        self._taken.append(corners)
        return True


def footprint(x: float, y: float, wide: float, deep: float, turn: float) -> Float[np.ndarray, "4 2"]:
    """Corners of a rectangle turned by `turn` degrees about its centre."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    half = np.array([[-wide, -deep], [wide, -deep], [wide, deep], [-wide, deep]]) / 2
    return half @ np.array([[c, s], [-s, c]]) + (x, y)


def overlap(a: Float[np.ndarray, "4 2"], b: Float[np.ndarray, "4 2"]) -> bool:
    """Whether two rectangles have area in common (separating axes)."""
    axes = np.stack([a[1] - a[0], a[3] - a[0], b[1] - b[0], b[3] - b[0]], axis=1)
    p, q = a @ axes, b @ axes
    return bool(((p.min(0) < q.max(0) - 1e-9) & (q.min(0) < p.max(0) - 1e-9)).all())


Make = Callable[[np.random.Generator], Furnishing]
"""Function that draws a furnishing of a kind."""


def draw(rng: np.random.Generator, makers: dict[Make, float]) -> Furnishing:
    """Draw one of several kinds, by weight."""
    weights = np.array(list(makers.values()))
    return list(makers)[rng.choice(len(weights), p=weights / weights.sum())](rng)
