"""Uniform skies."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds.base import Light, Scalar, Vector, pytree, register_light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import ILLUMINANCE, FileKey
from hyjax.light.kinds.shadow_views import ParallelViews
from hyjax.util import vectors
from hyjax.util.geometry import dot, unit

SKY_VIEWS = 32
"""Number of directions of a sky that its shadow map samples."""


@pytree
class SkyLight(Light):
    """Uniform sky: light from the whole hemisphere around `up`; `illuminance` is on an open surface facing up.

    E = E₀ (1 + n·up)/2.

    Attributes:
        up: unit vector to the middle of the hemisphere.
        illuminance: lux on an open surface that faces it.
        color: linear RGB; multiplies the strength.
    """

    KEYS = (FileKey("up", "direction", default=None), ILLUMINANCE)
    STRENGTH = "illuminance"
    up: Vector
    illuminance: Scalar
    color: Vector

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return self.illuminance * 0.5 * (1.0 + dot(n, unit(self.up)))

    def shadow_views(self) -> ParallelViews:
        dome = vectors.fibonacci_sphere(2 * SKY_VIEWS)[:SKY_VIEWS]  # its first half has z > 0
        return ParallelViews(-dome @ vectors.orthonormal_frame(self.up))

    def emitter(self) -> Emitter:
        return Emitter("sky", float(self.illuminance), direction=vectors.unit(self.up))

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        up = world_up if values["up"] is None else values["up"]
        return super().from_entry({**values, "up": np.asarray(up)}, world_up)


register_light("sky", SkyLight)
