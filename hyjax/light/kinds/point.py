"""Point lights and small bulbs."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds.base import Light, Scalar, Vector, pytree, register_light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import CLEARANCE, LUMINOUS_FLUX, RADIUS, FileKey
from hyjax.light.kinds.shadow_views import SPHERE, RadialViews
from hyjax.util.geometry import TINY, dot
from hyjax.util.vectors import fibonacci_sphere

BULB_VIEWS = 8
"""Number of points of a bulb that its shadow map samples, if it has a radius."""


@pytree
class PointLight(Light):
    """Point light, equal in all directions; a small ball of `radius` when shadows are cast.

    E = Φ/(4π) · cos θ / r². Nothing nearer than `clearance` casts a shadow (the lamp's own shade).

    Attributes:
        position: world metres.
        luminous_flux: lumens, of the whole lamp.
        color: linear RGB; multiplies the strength.
        radius: of the bulb in metres; softens its shadows.
        clearance: metres; nothing nearer than this casts a shadow.
    """

    KEYS = (FileKey("position", "vector"), LUMINOUS_FLUX, RADIUS, CLEARANCE)
    position: Vector
    luminous_flux: Scalar
    color: Vector
    radius: Scalar = 0.0
    clearance: Scalar = 0.0

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        cosine, inverse_square, _ = incidence(self.position, p, n)
        return self.luminous_flux / (4 * jnp.pi) * cosine * inverse_square

    def shadow_views(self) -> RadialViews:
        origins = bulb_points(self.position, self.radius)
        return RadialViews(origins, np.eye(3), "octahedral", SPHERE, float(self.clearance))

    def emitter(self) -> Emitter:
        position = np.asarray(self.position, np.float64)
        flux, extent, clearance = float(self.luminous_flux), float(self.radius), float(self.clearance)
        return Emitter("point", flux, position, extent=extent, clearance=clearance)


register_light("point", PointLight)


def incidence(
    light: Vector, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]
) -> tuple[Float[Array, "*s"], Float[Array, "*s"], Float[Array, "*s 3"]]:
    """Clamped cosine at the surface, 1/r² and unit vector to the light, for light from a point."""
    offset = light - p
    inverse_square = 1.0 / (dot(offset, offset) + TINY)
    to_light = offset * jnp.sqrt(inverse_square)[..., None]
    return jnp.maximum(dot(to_light, n), 0.0), inverse_square, to_light


def bulb_points(position: Vector, radius: Scalar) -> Float[np.ndarray, "v 3"]:
    """Sample points of a ball for shadows: its centre, or points of its surface if it has a radius."""
    centre = np.asarray(position, np.float64)
    return centre + float(radius) * fibonacci_sphere(BULB_VIEWS) if float(radius) > 0 else centre[None]
