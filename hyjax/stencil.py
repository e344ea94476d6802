"""Differences on the pixel grid. The last two axes are rows and columns; leading axes (channels) ride along.

Symbols of this file: y is a scalar field on the pixels, (H, W). An *edge* joins two neighbouring pixels, so
fields on edges come in pairs, vertical (H−1, W) and horizontal (H, W−1). There is no edge across the border of
the image, hence no flux through it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

Edges = tuple[Float[Array, "*c h-1 w"], Float[Array, "*c h w-1"]]


def gradient(y: Float[Array, "*c h w"]) -> Edges:
    """Difference along each edge: lower minus upper pixel, right minus left pixel."""
    return y[..., 1:, :] - y[..., :-1, :], y[..., 1:] - y[..., :-1]


def divergence(flux: Edges) -> Float[Array, "*c h w"]:
    """Net inflow into each pixel from its edges; the negative adjoint of `gradient`, so it sums to zero."""
    vertical, horizontal = flux
    rows, columns = [(0, 0)] * (vertical.ndim - 2), [(0, 0)] * (horizontal.ndim - 1)
    return (
        jnp.pad(vertical, [*rows, (0, 1), (0, 0)])
        - jnp.pad(vertical, [*rows, (1, 0), (0, 0)])
        + jnp.pad(horizontal, [*columns, (0, 1)])
        - jnp.pad(horizontal, [*columns, (1, 0)])
    )


def least_around(edges: Edges) -> Float[Array, "*c h w"]:
    """Of each pixel, the lesser value of the edges below and to its right, at most 1: edges as a picture."""
    vertical, horizontal = edges
    rows, columns = [(0, 0)] * (vertical.ndim - 2), [(0, 0)] * (horizontal.ndim - 1)
    down = jnp.pad(vertical, [*rows, (0, 1), (0, 0)], constant_values=1.0)
    return jnp.minimum(down, jnp.pad(horizontal, [*columns, (0, 1)], constant_values=1.0))
