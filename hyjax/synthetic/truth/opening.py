"""Openings: windows that let in light from a sky that depends on the direction."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.room.daylight import sky_radiance
from hyjax.synthetic.room.light import from_rectangle
from hyjax.util.vectors import unit

Radiance = Callable[[int, Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
"""Function from an opening (its number) and unit outward directions to radiance."""


@dataclasses.dataclass(frozen=True)
class Opening:
    """Window opening: the rectangle centre ± right ± up in the wall's inner face.

    Attributes:
        centre, right, up: metres.
        normal: unit, into the room.
        depth: of the reveal, metres: light comes from the rectangle that far outside.
    """

    centre: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    depth: float

    @property
    def outer(self) -> Float[np.ndarray, "3"]:
        """Centre of the outer rectangle."""
        return self.centre - self.depth * self.normal

    @property
    def area(self) -> float:
        """Area in square metres."""
        return float(4 * np.linalg.norm(np.cross(self.right, self.up)))

    def anchor(self) -> dict[str, object]:
        """Opening as plain numbers, an entry of a capture's anchors."""
        return {
            "center": [float(x) for x in self.centre],
            "right": [float(x) for x in self.right],
            "up": [float(x) for x in self.up],
            "normal": [float(x) for x in self.normal],
            "width": float(2 * np.linalg.norm(self.right)),
            "height": float(2 * np.linalg.norm(self.up)),
        }

    def to_sky(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Directions turned about z as if the window faced -x, like the built-in room's."""
        c, s = self.normal[:2] / np.linalg.norm(self.normal[:2])
        x, y, z = np.asarray(direction).T
        return np.stack([c * x + s * y, c * y - s * x, z], axis=-1).astype(np.float32)

    def sky(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Radiance of the hazy sky outside all windows, by unit direction."""
        return sky_radiance(self.to_sky(direction))

    def crossing(
        self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether rays leave through the opening."""
        facing = np.maximum(-(direction @ self.normal), 1e-6)
        distance = ((origin - self.outer) @ self.normal) / facing
        at = origin + distance[:, None] * direction - self.outer
        inside = (distance > 0) & (facing > 1e-5)
        for axis in (self.right, self.up):
            inside &= np.abs(at @ axis) <= 1.001 * (axis @ axis)
        return inside


def leaving(
    openings: list[Opening], origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
) -> Int[np.ndarray, "n"]:
    """Number of each ray's exit opening; -1 for none.

    A ray that slips through a crack goes with the window that it faces most, as in the built-in room.
    """
    if not openings:
        return np.full(len(direction), -1)
    facing = direction @ -np.stack([opening.normal for opening in openings], axis=1)
    through = np.where(facing.max(axis=1) > 0, facing.argmax(axis=1), -1)
    origin = np.broadcast_to(origin, direction.shape)
    for number, opening in enumerate(openings):
        through[opening.crossing(origin, direction)] = number
    return through


def cosine_share(
    opening: Opening,
    origin: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Weight of cosine sampling against window sampling for rays that leave (balance heuristic)."""
    facing = np.maximum(-(direction @ opening.normal), 1e-6)
    distance = ((origin - opening.outer) @ opening.normal) / facing
    by_window = distance**2 / (facing * opening.area)
    by_cosine = np.maximum(np.einsum("nk,nk->n", direction, normal), 0) / np.pi
    return by_cosine / (by_window + by_cosine)


def from_opening(
    caster: RayCaster,
    opening: Opening,
    radiance: Callable[[Float[np.ndarray, "m 3"]], Float[np.ndarray, "m 3"]],
    origin: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    square: Float[np.ndarray, "n k 2"],
) -> Float[np.ndarray, "n 3"]:
    """Irradiance / π from points in an opening, without the part that cosine sampling finds better."""
    place = 2 * square - 1
    target = opening.outer + place[..., :1] * opening.right + place[..., 1:] * opening.up

    def exact(direction: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3"]:
        return radiance(unit(direction).astype(np.float32))

    return from_rectangle(caster, target, opening.normal, opening.area, exact, origin, normal)
