"""Replacement of values that are not finite, so that they do not spread."""

import jax.numpy as jnp
from jaxtyping import Array, Float

LARGEST_VALUE = 1e15
"""Largest magnitude of a value; squares and sums of larger ones overflow single precision."""


def finite_or_zero(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Replace values that are not finite, or too large to be squared, by 0.

    In a guide, a zero is an edge around one pixel. A single comparison, which XLA fuses with what follows.

    >>> finite_or_zero(jnp.array([0.5, jnp.nan, -jnp.inf, 1e30])).tolist()
    [0.5, 0.0, 0.0, 0.0]
    """
    return jnp.where(jnp.abs(x) < min(LARGEST_VALUE, float(jnp.finfo(x.dtype).max)), x, 0.0)
