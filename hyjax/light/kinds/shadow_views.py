"""Views of a light's shadow map, as a kind of light declares them: plain numbers. Ray casting fills them."""

import dataclasses
import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

Projection = Literal["octahedral", "hemisphere", "perspective", "orthographic"]
SPHERE, HEMISPHERE = math.sqrt(4 * math.pi), math.sqrt(2 * math.pi)
"""Extents of octahedral and of hemisphere maps."""


@dataclasses.dataclass(frozen=True)
class RadialViews:
    """Rays that start in points of the light and spread out.

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
        """As many of the views at most, spread over all of them."""
        return dataclasses.replace(self, origins=self.origins[:: -(-self.count // most)])


@dataclasses.dataclass(frozen=True)
class ParallelViews:
    """Parallel rays, a bundle for each direction.

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
        """As many of the views at most, spread over all of them."""
        return dataclasses.replace(self, directions=self.directions[:: -(-self.count // most)])


ShadowViews = RadialViews | ParallelViews
