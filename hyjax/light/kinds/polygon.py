"""Form factors of polygons: the cosine-weighted share of a surface's hemisphere that an emitter fills."""

import functools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hyjax.util.geometry import TINY, Components, angle, cross_product, inner


def polygon_form_factor(corners: Sequence[Components], n: Components) -> Float[Array, "*s"]:
    """Form factor of a convex polygon for a surface point with unit normal n.

    F = 1/(2π) Σ θ_i Γ_i·n over the edges of the polygon clipped to the horizon plane (Lambert 1760; Baum, Rushmeier
    and Winget, *Improving radiosity solutions through the use of analytically determined form-factors*, 1989).
    Branch-free: each edge is clipped by itself, and the piece of horizon that closes the clipped polygon runs from
    the point where the outline goes under to the point where it comes up again.

    Args:
        corners: corners relative to the point, in order, counter-clockwise from there, or clockwise; each by its
            three components, like n.

    Returns:
        Fraction of the hemisphere, cosine-weighted, in [0, 1].
    """
    heights = [inner(c, n) for c in corners]
    total = jnp.zeros_like(heights[0])
    sinks = rises = [total] * 3
    edges = zip(corners, [*corners[1:], corners[0]], heights, [*heights[1:], heights[0]], strict=True)
    for a, b, ha, hb in edges:
        crosses = (ha > 0) != (hb > 0)
        t = jnp.where(crosses, ha / jnp.where(crosses, ha - hb, 1.0), 0.0)
        horizon = [x + t * (y - x) for x, y in zip(a, b, strict=True)]
        start, end, visible = _where(ha > 0, a, horizon), _where(hb > 0, b, horizon), (ha > 0) | (hb > 0)
        total += jnp.where(visible, _edge_integral(start, end, n, visible), 0.0)
        sinks = _where(crosses & (ha > 0), horizon, sinks)
        rises = _where(crosses & (hb > 0), horizon, rises)
    clipped = functools.reduce(jnp.logical_or, [h > 0 for h in heights]) & (
        functools.reduce(jnp.logical_or, [h <= 0 for h in heights])
    )
    total += jnp.where(clipped, _edge_integral(sinks, rises, n, clipped), 0.0)
    return jnp.abs(total) / (2 * jnp.pi)


def _where(condition: Bool[Array, "*s"], a: Components, b: Sequence[Any]) -> list[Array]:
    return [jnp.where(condition, x, y) for x, y in zip(a, b, strict=True)]


def _edge_integral(a: Components, b: Components, n: Components, valid: Bool[Array, "*s"]) -> Float[Array, "*s"]:
    """Angle subtended by edge a→b, times the component along n of its plane's unit normal."""
    # Invalid edges get harmless stand-ins, so that neither values nor gradients turn NaN.
    a, b = _where(valid, a, (1.0, 0.0, 0.0)), _where(valid, b, (0.0, 1.0, 0.0))
    normal = cross_product(a, b)
    sine = jnp.sqrt(inner(normal, normal) + TINY**2)
    return angle(sine, inner(a, b)) * inner(normal, n) / sine
