"""Spotlights: bulbs with a reflector."""

from collections.abc import Mapping
from typing import Any, Self

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds.base import Light, Scalar, Vector, pytree, register_light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import CLEARANCE, LUMINOUS_FLUX, RADIUS, FileKey
from hyjax.light.kinds.point import bulb_points, incidence
from hyjax.light.kinds.shadow_views import HEMISPHERE, RadialViews
from hyjax.util import vectors
from hyjax.util.errors import InputError
from hyjax.util.geometry import dot, unit

WIDEST_PERSPECTIVE = np.deg2rad(60.0)
"""Largest half angle of a perspective map, in radians; wider ones waste their texels on the rim."""


@pytree
class SpotLight(Light):
    """Cone of light around `direction`, full inside `inner_angle`, dark outside `outer_angle` (half angles).

    Intensity I(θ) = I₀ s(cos θ) with s a smoothstep between the two cosines; I₀ = Φ / (2π (1 − mean of the two
    cosines)) makes the whole cone emit exactly Φ.

    Attributes:
        position: world metres.
        direction: unit vector along which it shines.
        luminous_flux: lumens, of the whole cone.
        color: linear RGB; multiplies the strength.
        inner_angle: half angle of the full cone in radians.
        outer_angle: half angle beyond which it is dark, in radians.
        radius: of the lamp in metres; softens its shadows.
        clearance: metres; nothing nearer than this casts a shadow.
    """

    KEYS = (
        FileKey("position", "vector"),
        FileKey("target", "vector", default=None, written=False),
        FileKey("direction", "direction", default=None),
        LUMINOUS_FLUX,
        FileKey("inner_degrees", default=None, field="inner_angle", degrees=True),
        FileKey("outer_degrees", default=40.0, positive=True, most=90.0, field="outer_angle", degrees=True),
        RADIUS,
        CLEARANCE,
    )
    position: Vector
    direction: Vector
    luminous_flux: Scalar
    color: Vector
    inner_angle: Scalar
    outer_angle: Scalar
    radius: Scalar = 0.0
    clearance: Scalar = 0.0

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        cosine, inverse_square, to_light = incidence(self.position, p, n)
        inner, outer = jnp.cos(self.inner_angle), jnp.cos(self.outer_angle)
        t = (dot(-to_light, unit(self.direction)) - outer) / jnp.maximum(inner - outer, 1e-6)
        t = jnp.clip(t, 0.0, 1.0)
        peak = self.luminous_flux / (2 * jnp.pi * (1.0 - 0.5 * (inner + outer)))
        return peak * t * t * (3.0 - 2.0 * t) * cosine * inverse_square

    def shadow_views(self) -> RadialViews:
        origins, near = bulb_points(self.position, self.radius), float(self.clearance)
        axes, angle = vectors.orthonormal_frame(self.direction), float(self.outer_angle)
        if angle > WIDEST_PERSPECTIVE:
            return RadialViews(origins, axes, "hemisphere", HEMISPHERE, near)
        # The sources of a wide lamp see the rim of the cone from aside: a margin on the cone's angle.
        spread = np.tan(angle) * 1.05
        return RadialViews(origins, axes / [[spread], [spread], [1.0]], "perspective", 2 * spread, near)

    def emitter(self) -> Emitter:
        return Emitter(
            "spot",
            float(self.luminous_flux),
            np.asarray(self.position, np.float64),
            vectors.unit(self.direction),
            extent=float(self.radius),
            clearance=float(self.clearance),
            inner_angle=float(self.inner_angle),
            outer_angle=float(self.outer_angle),
        )

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        target, direction, inner = (values[key] for key in ("target", "direction", "inner_degrees"))
        if (target is None) == (direction is None):
            raise InputError("give either 'target' (a point) or 'direction'")
        if target is not None:
            direction = np.asarray(target, np.float32) - np.asarray(values["position"], np.float32)
        outer = values["outer_degrees"]
        inner = 0.7 * outer if inner is None else inner
        if inner >= outer:
            raise InputError(f"need inner_degrees < outer_degrees, got {inner:g} and {outer:g}")
        return super().from_entry({**values, "direction": direction, "inner_degrees": inner}, world_up)


register_light("spot", SpotLight)
