"""Form factors of polygons: the cosine-weighted share of a surface's hemisphere that an emitter fills."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.util.geometry import TINY, angle, cross, dot


def polygon_form_factor(corners: list[Float[Array, "*s 3"]], n: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Form factor of a convex polygon for a surface point with unit normal n.

    F = 1/(2π) Σ θ_i Γ_i·n over the edges of the polygon clipped to the horizon plane (Lambert 1760; Baum, Rushmeier
    and Winget, *Improving radiosity solutions through the use of analytically determined form-factors*, 1989).
    Branch-free: each edge is clipped by itself, and the piece of horizon that closes the clipped polygon runs from
    the point where the outline goes under to the point where it comes up again.

    Args:
        corners: corners relative to the point, in order, counter-clockwise from there, or clockwise.

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
    """Angle subtended by edge a→b, times the component along n of its plane's unit normal."""
    # Invalid edges get harmless stand-ins, so that neither values nor gradients turn NaN.
    a = jnp.where(valid[..., None], a, jnp.array([1.0, 0.0, 0.0], a.dtype))
    b = jnp.where(valid[..., None], b, jnp.array([0.0, 1.0, 0.0], b.dtype))
    normal = cross(a, b)
    sine = jnp.sqrt(dot(normal, normal) + TINY**2)
    return angle(sine, dot(a, b)) * dot(normal, n) / sine
