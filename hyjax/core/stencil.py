"""Differences on the pixel grid. The last two axes are rows and columns, leading axes are channels.

Symbols of this file: y is a scalar field on the pixels, (H, W). An *edge* joins two neighbouring pixels, so
fields on edges come in pairs, vertical (H−1, W) and horizontal (H, W−1). There is no edge across the border of
the image, hence no flux through it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

# The names of axes cannot say h - 1 before h is known.
Edges = tuple[Float[Array, "... h_1 w"], Float[Array, "... h w_1"]]
CoarseEdges = tuple[Float[Array, "... ch_1 cw"], Float[Array, "... ch cw_1"]]


def gradient(y: Float[Array, "*c h w"]) -> Edges:
    """Difference along each edge: lower minus upper pixel, right minus left pixel.

    >>> down, right = gradient(jnp.array([[1.0, 2.0], [4.0, 8.0]]))
    >>> down.tolist(), right.tolist()
    ([[3.0, 6.0]], [[1.0], [4.0]])
    """
    return y[..., 1:, :] - y[..., :-1, :], y[..., 1:] - y[..., :-1]


def divergence(flux: Edges) -> Float[Array, "*c h w"]:
    """Net inflow into each pixel from its edges; the negative adjoint of `gradient`, so it sums to zero.

    >>> y = jnp.array([[0.0, 1.0, 0.0]])
    >>> divergence(gradient(y)).tolist()
    [[1.0, -2.0, 1.0]]
    """
    vertical, horizontal = flux
    rows, columns = [(0, 0)] * (vertical.ndim - 2), [(0, 0)] * (horizontal.ndim - 1)
    return (
        jnp.pad(vertical, [*rows, (0, 1), (0, 0)])
        - jnp.pad(vertical, [*rows, (1, 0), (0, 0)])
        + jnp.pad(horizontal, [*columns, (0, 1)])
        - jnp.pad(horizontal, [*columns, (1, 0)])
    )


def least_around(edges: Edges) -> Float[Array, "*c h w"]:
    """Smaller value of the edges below and to the right of each pixel, at most 1: edges as a picture.

    >>> least_around((jnp.zeros((0, 3)), jnp.array([[0.5, 2.0]]))).tolist()
    [[0.5, 1.0, 1.0]]
    """
    vertical, horizontal = edges
    rows, columns = [(0, 0)] * (vertical.ndim - 2), [(0, 0)] * (horizontal.ndim - 1)
    down = jnp.pad(vertical, [*rows, (0, 1), (0, 0)], constant_values=1.0)
    return jnp.minimum(down, jnp.pad(horizontal, [*columns, (0, 1)], constant_values=1.0))
