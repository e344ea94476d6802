"""Sun and moon, also through a window."""

from collections.abc import Mapping
from typing import Any, Self

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds.aperture import RECTANGLE, Aperture
from hyjax.light.kinds.base import Light, Scalar, Vector, color_of, pytree, register_light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import ILLUMINANCE, FileKey, fields_of
from hyjax.light.kinds.shadow_views import ParallelViews
from hyjax.util import vectors
from hyjax.util.errors import InputError
from hyjax.util.geometry import cross, dot, unit

SUN_DEGREES = 0.27
"""Angular radius of the sun's disc, and of the moon's, in degrees."""
SUN_VIEWS = 4
"""Directions over the disc that the shadow map samples."""
MOST_DEGREES = 45.0
"""Largest angular radius of a disc, in degrees."""


@pytree
class DirectionalLight(Light):
    """Sun or moon: parallel light along `direction`; `illuminance` is on a surface that faces it.

    E = E₀ cos θ. `angular_radius` of the disc softens its shadows (sun and moon: 0.0047). With an `aperture` the
    light comes in through that opening alone, and the shadow map has where it falls: a scanned room has no outer
    walls to keep the sun out, and often no hole where the window is.

    Attributes:
        direction: unit vector along which the light travels.
        illuminance: lux on a surface that faces it.
        color: linear RGB; multiplies the strength.
        angular_radius: of the disc in radians.
        aperture: opening that it comes in through; None for everywhere.
    """

    KEYS = (
        FileKey("direction", "direction"),
        ILLUMINANCE,
        FileKey("angular_degrees", default=SUN_DEGREES, field="angular_radius", degrees=True),
        FileKey("aperture", RECTANGLE, default=None, written=False),
    )
    STRENGTH = "illuminance"
    direction: Vector
    illuminance: Scalar
    color: Vector
    angular_radius: Scalar = 0.0
    aperture: Aperture | None = None

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return self.illuminance * jnp.maximum(dot(-n, unit(self.direction)), 0.0)

    def shadow_views(self) -> ParallelViews:
        directions, spread = vectors.unit(self.direction)[None], float(self.angular_radius)
        if spread > 0:
            disc = vectors.fibonacci_disc(SUN_VIEWS) * spread
            directions = vectors.unit(directions + disc @ vectors.orthonormal_frame(directions[0])[:2])
        return ParallelViews(directions, self.aperture)

    def mask_visibility(self, visibility: Float[Array, "*s"], position: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        """Visibility behind the aperture; 0 on the sun's side of it, where no light comes through."""
        if self.aperture is None:
            return visibility
        across = cross(self.aperture.right, self.aperture.up)
        side = dot(position - self.aperture.center, across) * dot(self.direction, across)
        return jnp.where(side > 0, visibility, 0.0)

    def emitter(self) -> Emitter:
        strength, direction = float(self.illuminance), vectors.unit(self.direction)
        extent = float(self.angular_radius)
        return Emitter("directional", strength, direction=direction, extent=extent, aperture=self.aperture)

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        if (degrees := values["angular_degrees"]) > MOST_DEGREES:
            raise InputError(f"'angular_degrees' must be at most 45, got {degrees:g}; use a sky for more")
        fields, aperture = fields_of(cls.KEYS, values), None
        if values["aperture"] is not None:
            try:
                aperture = Aperture.from_entry(values["aperture"], world_up)
            except InputError as error:
                raise InputError(f"aperture: {error}") from None
            if abs(fields["direction"] @ vectors.unit(np.cross(aperture.right, aperture.up))) < 0.01:
                raise InputError("'direction' runs along the aperture's plane; no light can come through")
        return cls(**fields, color=color_of(values), aperture=aperture)

    def to_entry(self) -> dict[str, Any]:
        aperture = {} if self.aperture is None else {"aperture": self.aperture.to_entry()}
        return super().to_entry() | aperture


register_light("directional", DirectionalLight)
