"""Views of a light's shadow map, plain numbers declared by its kind. Ray casting fills them."""

import dataclasses
import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

Projection = Literal["octahedral", "hemisphere", "perspective", "orthographic"]
SPHERE, HEMISPHERE = math.sqrt(4 * math.pi), math.sqrt(2 * math.pi)
"""Extents of octahedral and of hemisphere maps."""


@dataclasses.dataclass(frozen=True)
class RadialViews:
    """Bundles of rays that start in points of the light and spread out.

    Attributes:
        origins: the points, world metres.
        axes: rows are the views' axes in world coordinates, see `hyjax.light.shadow_map.ShadowMap`.
        projection: how directions map to the square.
        extent: the map's width in radians; of perspective maps in tangents.
        near: distance from the points at which rays start, metres.
    """

    origins: Float[np.ndarray, "v 3"]
    axes: Float[np.ndarray, "3 3"]
    projection: Projection
    extent: float
    near: float = 0.0

    @property
    def count(self) -> int:
        return len(self.origins)

    def thinned(self, most: int) -> "RadialViews":
        """Views thinned to at most `most`, spread as evenly as before."""
        return dataclasses.replace(self, origins=self.origins[even_subset(self.origins, most)])


@dataclasses.dataclass(frozen=True)
class ParallelViews:
    """Bundles of parallel rays, one for each direction.

    Attributes:
        directions: in which the light travels, unit.
        aperture: the `Aperture` that all rays start in; None for rays over the whole mesh.
    """

    directions: Float[np.ndarray, "v 3"]
    aperture: Any = None

    @property
    def count(self) -> int:
        return len(self.directions)

    def thinned(self, most: int) -> "ParallelViews":
        """Views thinned to at most `most`, spread as evenly as before."""
        return dataclasses.replace(self, directions=self.directions[even_subset(self.directions, most)])


def even_subset(points: Float[np.ndarray, "n 3"], most: int) -> Int[np.ndarray, "m"]:
    """Indices of at most `most` points whose mean and covariance are nearest to those of all points.

    Tried are arithmetic progressions, wrapped round at the end, from the first point: in low-discrepancy sequences
    some are spread evenly, and others clump.

    >>> even_subset(np.eye(3)[[0, 1, 0, 1]], 2).tolist()
    [0, 1]
    """
    count = len(points)
    if most >= count:
        return np.arange(count)
    points = points - points.mean(axis=0)
    spread = points.T @ points / count
    tried = [np.arange(max(most, 1)) * step % count for step in range(1, count)]

    def badness(chosen: Int[np.ndarray, "m"]) -> float:
        some = points[chosen]
        off = some.mean(axis=0)
        twice = len(np.unique(chosen)) < len(chosen)
        return float(np.sum(off**2) + np.linalg.norm(some.T @ some / len(some) - spread)) + (1e9 if twice else 0.0)

    return min(tried, key=badness)


ShadowViews = RadialViews | ParallelViews
