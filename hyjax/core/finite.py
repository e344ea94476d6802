"""Values that are not finite, kept from spreading."""

import jax.numpy as jnp
from jaxtyping import Array, Float

LARGEST = 1e15
"""Beyond, squares and sums of values overflow single precision."""


def finite_or_zero(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """The values; 0 in the place of those that are not finite, or too large to be squared.

    In a guide, a zero is an edge around one pixel. A single comparison, which XLA fuses with what follows.

    >>> finite_or_zero(jnp.array([0.5, jnp.nan, -jnp.inf, 1e30])).tolist()
    [0.5, 0.0, 0.0, 0.0]
    """
    return jnp.where(jnp.abs(x) < min(LARGEST, float(jnp.finfo(x.dtype).max)), x, 0.0)
