"""Outliers of light on a scan's vertices: single ones whose rays hit or miss something bright by chance."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

OUTLIER_RANGE = 3.0
"""Largest distance of a value outside the range of its neighbours' values, over that range."""
FEWEST_NEIGHBOURS = 8
"""Fewest corners of triangles around a vertex that is judged: four triangles, as a vertex at a rim hardly has."""


@jax.jit
def without_outliers(values: Float[Array, "v c"], faces: Int[Array, "f 3"]) -> Float[Array, "v c"]:
    """Values held to the range of their neighbours' and three times as much: slopes and corners stay, dots go."""
    ends = jnp.concatenate([faces[:, k] for k in (0, 1, 2, 0, 1, 2)])
    starts = jnp.concatenate([faces[:, k] for k in (1, 2, 0, 2, 0, 1)])
    around = values[starts]
    low = jnp.full_like(values, jnp.inf).at[ends].min(around)
    high = jnp.full_like(values, -jnp.inf).at[ends].max(around)
    judged = jnp.zeros(len(values), jnp.int32).at[ends].add(1)[:, None] >= FEWEST_NEIGHBOURS
    slack = OUTLIER_RANGE * (high - low)
    return jnp.where(judged, jnp.clip(values, low - slack, high + slack), values)
