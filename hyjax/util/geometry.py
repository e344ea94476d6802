"""Sums over the three components of vectors, written out.

XLA's CPU backend reduces a short last axis element by element; written out, the same sum fuses with what surrounds
it and runs faster.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

TINY = 1e-12
"""Keeps divisions by squared lengths and by weights finite."""
Components = Sequence[Array] | Array
"""Vectors component by component: a sequence of three arrays, or a leading axis."""


def inner(a: Components, b: Components) -> Array:
    """Inner product of vectors given component by component."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross_product(a: Components, b: Components) -> list[Array]:
    """Cross product of vectors given component by component."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def components(a: Float[Array, "*s 3"]) -> list[Array]:
    """Components of vectors along the last axis."""
    return [a[..., k] for k in range(3)]


def dot(a: Float[Array, "*s 3"], b: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Inner product along the last axis."""
    return inner(components(a), components(b))


def cross(a: Float[Array, "*s 3"], b: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """Cross product along the last axis."""
    return jnp.stack(cross_product(components(a), components(b)), axis=-1)


def unit(a: Float[Array, "*s 3"]) -> Float[Array, "*s 3"]:
    """The vector divided by its length, which must not be zero."""
    return a / jnp.sqrt(dot(a, a))[..., None]


@jax.custom_jvp
def angle(sine: Float[Array, "*s"], cosine: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Angle in [0, π] by its sine ≥ 0 and its cosine, which may be scaled alike; 0 where both are 0.

    >>> [round(float(angle(jnp.sin(x), jnp.cos(x))), 6) for x in jnp.array([0.0, 0.5, 3.0])]
    [0.0, 0.5, 3.0]

    In single precision by Cephes' polynomial (Moshier, *Methods and Programs for Mathematical Functions*, 1989),
    whose error is of a unit or two in the last place: `jnp.arctan2` takes ten times longer on a CPU.
    """
    if sine.dtype != jnp.float32:
        return jnp.arctan2(sine, cosine)
    flat = jnp.abs(cosine)
    low, high = jnp.minimum(sine, flat), jnp.maximum(sine, flat)
    turned = low > 0.41421357 * high  # tan(π/8): the slope's angle is taken from π/4
    x = jnp.where(turned, low - high, low) / jnp.maximum(jnp.where(turned, low + high, high), TINY**3)
    z = x * x
    slope = x + x * z * (((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1)
    slope = slope + jnp.where(turned, 0.25 * np.pi, 0.0)
    slope = jnp.where(sine > flat, 0.5 * np.pi - slope, slope)
    return jnp.where(cosine < 0, np.pi - slope, slope)


@angle.defjvp
def _angle_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (sine, cosine), (of_sine, of_cosine) = primals, tangents
    squared = jnp.maximum(sine * sine + cosine * cosine, TINY**3)
    return angle(sine, cosine), (cosine * of_sine - sine * of_cosine) / squared
