"""Sums over the three components of vectors, written out.

XLA's CPU backend reduces a short last axis element by element; written out, the same sum fuses with what surrounds
it and runs faster.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

TINY = 1e-12
"""Keeps divisions by squared lengths and by weights finite."""


def inner(a: Sequence[Array] | Array, b: Sequence[Array] | Array) -> Array:
    """Inner product of vectors given component by component: sequences of three arrays, or a leading axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def dot(a: Float[Array, "*s 3"], b: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Inner product along the last axis."""
    return inner([a[..., k] for k in range(3)], [b[..., k] for k in range(3)])


def cross(a: Float[Array, "*s 3"], b: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """Cross product along the last axis."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return jnp.stack([x, y, z], axis=-1)


def unit(a: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """The vector divided by its length, which must not be zero."""
    return a / jnp.sqrt(dot(a, a))[..., None]
