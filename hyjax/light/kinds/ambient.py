"""Ambient light: the same illuminance on every surface."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.light.kinds.base import Light, Scalar, Vector, pytree, register_light
from hyjax.light.kinds.file_keys import ILLUMINANCE


@pytree
class AmbientLight(Light):
    """Ambient light: the same illuminance on every surface, as after many bounces. It casts no shadow.

    Attributes:
        illuminance: lux on every surface.
        color: linear RGB; multiplies the strength.
    """

    UNIFORM = True
    KEYS = (ILLUMINANCE,)
    STRENGTH = "illuminance"
    illuminance: Scalar
    color: Vector

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return jnp.broadcast_to(self.illuminance, p.shape[:-1])


register_light("ambient", AmbientLight)
