"""Virtual lights and the irradiance that each throws on a surface, shadows aside.

Units: positions and lengths in metres, angles in radians, `power` in lumens (of the whole emitter), `illuminance`
in lux (lumens per square metre). `color` is linear RGB and multiplies them, so that a lamp of 800 lm with colour
(1, 1, 1) is white. All lights are pytrees whose every field is an array: anything may be optimised.

Every light's `lux(p, n)` is the illuminance that it would throw on a surface if it were white: p world positions
and n unit normals, both (..., 3), the result (...). Its `irradiance` is that times the colour, (..., 3).
"""

import dataclasses
import functools
from typing import TypeVar, dataclass_transform

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.vectors import cross, dot, unit

T = TypeVar("T")
TINY = 1e-12  # keeps divisions finite at the light itself, in square metres


@dataclass_transform(frozen_default=True, eq_default=False)
def _pytree(cls: type[T]) -> type[T]:
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True, eq=False)(cls))


class _Light:
    color: Float[Array, "3"]

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        raise NotImplementedError

    def irradiance(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
        """Lux for red, green and blue."""
        return self.lux(p, n)[..., None] * self.color


@_pytree
class PointLight(_Light):
    """Shines equally in all directions; a small ball of `radius` when shadows are cast.

    E = Φ/(4π) · cos θ / r². Nothing nearer than `clearance` casts a shadow (the lamp's own shade).
    """

    position: Float[Array, "3"]
    power: Float[Array, ""]
    color: Float[Array, "3"]
    radius: Float[Array, ""] | float = 0.0
    clearance: Float[Array, ""] | float = 0.0

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        cosine, inverse_square, _ = _towards(self.position, p, n)
        return self.power / (4 * jnp.pi) * cosine * inverse_square


@_pytree
class SpotLight(_Light):
    """A cone around `direction`, full inside `inner_angle`, dark outside `outer_angle` (half angles).

    Intensity I(θ) = I₀ s(cos θ) with s a smoothstep between the two cosines; I₀ = Φ / (2π (1 − mean of the two
    cosines)) makes the whole cone emit exactly Φ.
    """

    position: Float[Array, "3"]
    direction: Float[Array, "3"]
    power: Float[Array, ""]
    color: Float[Array, "3"]
    inner_angle: Float[Array, ""]
    outer_angle: Float[Array, ""]
    radius: Float[Array, ""] | float = 0.0
    clearance: Float[Array, ""] | float = 0.0

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        cosine, inverse_square, to_light = _towards(self.position, p, n)
        inner, outer = jnp.cos(self.inner_angle), jnp.cos(self.outer_angle)
        t = (dot(-to_light, unit(self.direction)) - outer) / jnp.maximum(inner - outer, 1e-6)
        t = jnp.clip(t, 0.0, 1.0)
        peak = self.power / (2 * jnp.pi * (1.0 - 0.5 * (inner + outer)))
        return peak * t * t * (3.0 - 2.0 * t) * cosine * inverse_square


@_pytree
class Aperture:
    """An opening, such as a window: the rectangle with corners centre ± right ± up."""

    center: Float[Array, "3"]
    right: Float[Array, "3"]
    up: Float[Array, "3"]


@_pytree
class DirectionalLight(_Light):
    """Sun or moon: parallel light travelling along `direction`; `illuminance` is on a surface facing it.

    E = E₀ cos θ. `angular_radius` of the disc softens its shadows (sun and moon: 0.0047). With an `aperture` the
    light comes in through that opening alone, and the shadow map says where it falls: a scanned room has no outer
    walls to keep the sun out, and often no hole where the window is.
    """

    direction: Float[Array, "3"]
    illuminance: Float[Array, ""]
    color: Float[Array, "3"]
    angular_radius: Float[Array, ""] | float = 0.0
    aperture: Aperture | None = None

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return self.illuminance * jnp.maximum(dot(-n, unit(self.direction)), 0.0)


@_pytree
class RectLight(_Light):
    """A window or panel: a Lambertian rectangle that emits to the side of `right` × `up`.

    `right` and `up` are half-axes: the corners are centre ± right ± up. Radiance is L = Φ/(π A); irradiance is
    exact, by Lambert's formula for polygons with the part below the surface's horizon cut off.
    """

    center: Float[Array, "3"]
    right: Float[Array, "3"]
    up: Float[Array, "3"]
    power: Float[Array, ""]
    color: Float[Array, "3"]

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        normal = cross(self.right, self.up)
        area = 4.0 * jnp.sqrt(dot(normal, normal))
        corners = [self.center + s * self.right + t * self.up for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        in_front = dot(p - self.center, normal) > 0
        form_factor = polygon_form_factor([c - p for c in corners], n)
        # E = π L F with L = Φ/(π A)
        return jnp.where(in_front, form_factor, 0.0) * (self.power / area)


@_pytree
class SkyLight(_Light):
    """A uniform sky: light from the whole hemisphere around `up`; `illuminance` is on an open surface facing up.

    E = E₀ (1 + n·up)/2.
    """

    up: Float[Array, "3"]
    illuminance: Float[Array, ""]
    color: Float[Array, "3"]

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return self.illuminance * 0.5 * (1.0 + dot(n, unit(self.up)))


@_pytree
class AmbientLight(_Light):
    """The same illuminance on every surface: what is left of light that has bounced many times. No shadow."""

    illuminance: Float[Array, ""]
    color: Float[Array, "3"]

    def lux(self, p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
        return jnp.broadcast_to(self.illuminance, p.shape[:-1])


Light = PointLight | SpotLight | DirectionalLight | RectLight | SkyLight | AmbientLight


def polygon_form_factor(corners: list[Float[Array, "*s 3"]], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Form factor of a convex polygon, seen from a point with unit normal n.

    F = 1/(2π) Σ θ_i Γ_i·n over the edges of the polygon clipped to the horizon plane (Lambert 1760; Baum, Rushmeier
    and Winget, *Improving radiosity solutions through the use of analytically determined form-factors*, 1989).
    Branch-free: each edge is clipped by itself, and the piece of horizon that closes the clipped polygon runs from
    the point where the outline goes under to the point where it comes up again.

    Args:
        corners: corners relative to the point, in order, counter-clockwise as seen from it or clockwise.
        n: unit normal of the receiving surface.

    Returns:
        Fraction of the hemisphere, cosine-weighted, in [0, 1].
    """
    heights = [dot(c, n) for c in corners]
    total = jnp.zeros_like(heights[0])
    sinks = rises = jnp.zeros_like(corners[0])
    for a, b, ha, hb in zip(corners, corners[1:] + corners[:1], heights, heights[1:] + heights[:1], strict=True):
        crosses = (ha > 0) != (hb > 0)
        t = jnp.where(crosses, ha / jnp.where(crosses, ha - hb, 1.0), 0.0)
        horizon = a + t[..., None] * (b - a)
        start = jnp.where((ha > 0)[..., None], a, horizon)
        end = jnp.where((hb > 0)[..., None], b, horizon)
        visible = (ha > 0) | (hb > 0)
        total += jnp.where(visible, _edge_integral(start, end, n, visible), 0.0)
        sinks = jnp.where((crosses & (ha > 0))[..., None], horizon, sinks)
        rises = jnp.where((crosses & (hb > 0))[..., None], horizon, rises)
    clipped = functools.reduce(jnp.logical_or, [h > 0 for h in heights]) & (
        functools.reduce(jnp.logical_or, [h <= 0 for h in heights])
    )
    total += jnp.where(clipped, _edge_integral(sinks, rises, n, clipped), 0.0)
    return jnp.abs(total) / (2 * jnp.pi)


def _edge_integral(
    a: Float[Array, "*s 3"], b: Float[Array, "*s 3"], n: Float[Array, "*s 3"], valid: Array
) -> Float[Array, "*s"]:
    """Angle that edge a→b subtends, times the component along n of its plane's unit normal."""
    # Invalid edges get harmless stand-ins, so that neither values nor gradients turn NaN.
    a = jnp.where(valid[..., None], a, jnp.array([1.0, 0.0, 0.0], a.dtype))
    b = jnp.where(valid[..., None], b, jnp.array([0.0, 1.0, 0.0], b.dtype))
    normal = cross(a, b)
    sine = jnp.sqrt(dot(normal, normal) + TINY**2)
    return jnp.arctan2(sine, dot(a, b)) * dot(normal, n) / sine


def _towards(
    light: Float[Array, "3"], p: Float[Array, "*s 3"], n: Float[Array, "*s 3"]
) -> tuple[Float[Array, "*s"], Float[Array, "*s"], Float[Array, "*s 3"]]:
    """Clamped cosine at the surface, 1/r², unit vector to the light."""
    offset = light - p
    inverse_square = 1.0 / (dot(offset, offset) + TINY)
    to_light = offset * jnp.sqrt(inverse_square)[..., None]
    return jnp.maximum(dot(to_light, n), 0.0), inverse_square, to_light
