"""Rectangular lights: windows and panels."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds.aperture import RECTANGLE, Aperture
from hyjax.light.kinds.base import Light, Scalar, Vector, color_of, pytree, register_light
from hyjax.light.kinds.emitter import Emitter
from hyjax.light.kinds.file_keys import LUMINOUS_FLUX, plain
from hyjax.light.kinds.polygon import polygon_form_factor
from hyjax.light.kinds.shadow_views import HEMISPHERE, RadialViews
from hyjax.util.arguments import checked_arguments
from hyjax.util.geometry import components, cross, dot, inner
from hyjax.util.vectors import orthonormal_frame, r2_sequence

WINDOW_VIEWS = 16
"""Number of points of a window that its shadow map samples."""


@pytree
class RectLight(Light):
    """Window or panel: a Lambertian rectangle that emits to the side of `right` × `up`.

    `right` and `up` are half-axes: the corners are centre ± right ± up. Radiance is L = Φ/(π A); illuminance is
    exact, by Lambert's formula for polygons with the part below the surface's horizon cut off.

    Attributes:
        center: world metres.
        right: half-axis in metres.
        up: half-axis in metres.
        luminous_flux: lumens, of the whole rectangle.
        color: linear RGB; multiplies the strength.
    """

    KEYS = (*RECTANGLE, LUMINOUS_FLUX)
    center: Vector
    right: Vector
    up: Vector
    luminous_flux: Scalar
    color: Vector

    @classmethod
    @checked_arguments
    def filling(cls, opening: Aperture, luminous_flux: Scalar, color: Vector) -> Self:
        """Light of an opening's place and size."""
        return cls(opening.center, opening.right, opening.up, luminous_flux, color)

    def illuminance_at(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        normal = cross(self.right, self.up)
        area = 4.0 * jnp.sqrt(dot(normal, normal))
        corners = [self.center + s * self.right + t * self.up for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        in_front = dot(p - self.center, normal) > 0
        place = components(p)
        seen = [[c[k] - place[k] for k in range(3)] for c in corners]
        form_factor = polygon_form_factor(seen, components(n))
        # E = π L F with L = Φ/(π A)
        return jnp.where(in_front, form_factor, 0.0) * (self.luminous_flux / area)

    def shadow_views(self) -> RadialViews:
        # On a grid the views' shadows of a straight edge fall on top of each other: broad bands in the penumbra.
        right, up = np.asarray(self.right, np.float64), np.asarray(self.up, np.float64)
        s, t = r2_sequence(WINDOW_VIEWS).T[..., None] * 2.0 - 1.0
        origins = np.asarray(self.center, np.float64) + s * right + t * up
        return RadialViews(origins, orthonormal_frame(np.cross(right, up)), "hemisphere", HEMISPHERE)

    def view_weight(
        self,
        cosine: Float[Array, "..."],
        squared: Float[Array, "..."],
        to_light: Sequence[Float[Array, "..."]],
    ) -> Float[Array, "..."]:
        """Share of one shadow view, which for a Lambertian emitter includes the cosine at the light."""
        return cosine / squared * jnp.maximum(-inner(to_light, cross(self.right, self.up)), 0.0)

    def emitter(self) -> Emitter:
        center, right, up = (np.asarray(v, np.float64) for v in (self.center, self.right, self.up))
        return Emitter("rect", float(self.luminous_flux), center, right=right, up=up)

    @classmethod
    def from_entry(cls, values: Mapping[str, Any], world_up: Vector) -> Self:
        flux = LUMINOUS_FLUX.to_field(values["luminous_flux"])
        return cls.filling(Aperture.from_entry(values, world_up), flux, color_of(values))

    def to_entry(self) -> dict[str, Any]:
        rectangle = Aperture(self.center, self.right, self.up).to_entry()
        return rectangle | {"luminous_flux": plain(self.luminous_flux), "color": plain(self.color)}


register_light("rect", RectLight)
