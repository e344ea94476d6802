"""Training targets of a guide: pictures with the borders of the objects, and the borders themselves.

From one depth map with normals come, with fresh random numbers for every sample,

- *tinted depth*, the paper's: depth times three random factors, which makes a three-channel picture of it;
- *shading*: the surface under random coloured lamps, which is what the guide is for. It changes at creases too,
  where depth does not jump;
- *borders*: where depth jumps or the normal turns. These say directly where no light may flow.

Symbols of this file: d depth, n normals in camera axes, v validity, all H×W.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from hyjax.core.stencil import Edges, gradient
from hyjax.light.kinds import PointLight

TINT = (0.5, 1.5)
LAMPS = 3
AMBIENT_SHARE = 0.2
"""Ambient part of the shading target over the lamps' mean: shading must be positive to be adjusted."""
LARGEST_BRIGHTNESS = 4.0
"""Largest brightness of a lamp over its mean in the picture, as glare teaches nothing."""
FOCAL_LENGTH = 450.0
"""Focal length in pixels: crops do not know theirs, and lamps anywhere will do."""
DEPTH_JUMP = 0.03
"""Jump of depth at a border, as a share of depth, beyond the neighbouring slope."""
BORDER_COSINE = 0.94
"""Cosine between normals of neighbouring pixels below which they have a border, some 20 degrees."""
STRAIGHT_PIXELS = 8
"""Pixels on both sides over which depth must go straight on to exclude a border without normals."""
STRAIGHT_TOLERANCE = 0.004
"""Tolerance of that straightness, as a share of depth; at focal lengths up to 700 pixels a crease of 20 degrees
bends depth by more."""


class Sample(NamedTuple):
    """Training crop, or a batch of crops. Normals are zero where unknown, which may be everywhere."""

    image: Float[Array, "*b h w 3"]
    depth: Float[Array, "*b h w"]
    valid: Bool[Array, "*b h w"]
    normal: Float[Array, "*b h w 3"]


def mean_over(x: Float[Array, "h w *c"], valid: Bool[Array, "h w"]) -> Float[Array, "*c"]:
    """Mean over the valid pixels, 0 if there are none."""
    weight = valid.astype(x.dtype).reshape(valid.shape + (1,) * (x.ndim - 2))
    return jnp.sum(x * weight, axis=(0, 1)) / jnp.maximum(jnp.sum(weight), 1.0)


def relative_depth(sample: Sample) -> Float[Array, "h w"]:
    """Depth in multiples of its mean; 1 where invalid, so that it is positive everywhere."""
    mean = jnp.maximum(mean_over(sample.depth, sample.valid), 1e-6)
    return jnp.where(sample.valid, sample.depth / mean, 1.0)


def tinted_depth(sample: Sample, key: Key[Array, ""]) -> Float[Array, "h w 3"]:
    """Depth as a three-channel picture: times three random factors (the paper's training section)."""
    tint = jax.random.uniform(key, (3,), minval=TINT[0], maxval=TINT[1])
    return relative_depth(sample)[..., None] * tint


def random_shading(sample: Sample, key: Key[Array, ""]) -> Float[Array, "h w 3"]:
    """Shading of the surface by random coloured lamps and a little ambient light, about 1 on average.

    Lamps lie anywhere from behind the camera to the depth of the scene. Lengths are multiples of the mean depth.
    It is valid where `lit` is true; elsewhere it is plain ambient light.
    """
    h, w = sample.depth.shape
    depth = relative_depth(sample)
    u, v = jnp.meshgrid((jnp.arange(w) - (w - 1) / 2) / FOCAL_LENGTH, (jnp.arange(h) - (h - 1) / 2) / FOCAL_LENGTH)
    position = depth[..., None] * jnp.stack([u, v, jnp.ones_like(u)], axis=-1)
    is_lit = lit(sample)
    total = jnp.full((h, w, 3), AMBIENT_SHARE)
    for lamp_key in jax.random.split(key, LAMPS):
        place_key, color_key = jax.random.split(lamp_key)
        lamp_position = jax.random.uniform(
            place_key, (3,), minval=jnp.array([-1.2, -1.2, -0.5]), maxval=jnp.array([1.2, 1.2, 1.1])
        )
        color = jax.random.uniform(color_key, (3,), minval=0.1, maxval=1.0)
        lamp = PointLight(lamp_position, jnp.asarray(1.0), color)
        lux = jnp.where(is_lit, lamp.illuminance_at(position, sample.normal), 0.0)
        lux = lux / jnp.maximum(mean_over(lux, is_lit), 1e-6)
        total = total + jnp.minimum(lux, LARGEST_BRIGHTNESS)[..., None] * (color / LAMPS)
    return total


def lit(sample: Sample) -> Bool[Array, "h w"]:
    """Mask of the pixels that can be shaded: valid depth and a known normal."""
    return sample.valid & jnp.any(sample.normal != 0, axis=-1)


def borders(sample: Sample) -> tuple[Edges, Edges]:
    """Borders between neighbouring pixels, where objects end and surfaces turn.

    A depth jump is a second difference, so that a slanted plane is none: depth changes across the edge by more than
    `DEPTH_JUMP` beyond the smaller of the changes on both sides of it.

    Returns:
        (border, known): 1 where there is a border, and 1 where that is known, each on the edges as (vertical,
        horizontal).
    """
    depth = relative_depth(sample)
    vertical = _borders(depth, sample.normal, sample.valid)
    horizontal = _borders(depth.T, jnp.swapaxes(sample.normal, 0, 1), sample.valid.T)
    return (vertical[0], horizontal[0].T), (vertical[1], horizontal[1].T)


def _borders(depth: Array, normal: Array, valid: Array) -> tuple[Array, Array]:
    change, _ = gradient(depth)
    known = valid[1:] & valid[:-1]
    change = jnp.where(known, change, 0.0)
    above, below = (jnp.pad(change, ((1, 1), (0, 0)), mode="edge")[k : k + change.shape[0]] for k in (0, 2))
    slope = jnp.where(jnp.abs(above) < jnp.abs(below), above, below)
    nearer = jnp.minimum(depth[1:], depth[:-1])
    jumps = jnp.abs(change - slope) > DEPTH_JUMP * nearer
    turned = jnp.sum(normal[1:] * normal[:-1], axis=-1)
    have = jnp.any(normal != 0, axis=-1)
    turns = have[1:] & have[:-1] & (turned < BORDER_COSINE)
    border = known & (jumps | turns)
    # Without normals there may be a crease wherever depth bends.
    known = border | (known & ((have[1:] & have[:-1]) | _straight(depth, valid)))
    return border.astype(depth.dtype), known.astype(depth.dtype)


def _straight(depth: Array, valid: Array) -> Array:
    """Mask of the edges across which depth goes straight on."""
    count = depth.shape[0] - 1
    d, v = (jnp.pad(x, ((STRAIGHT_PIXELS, STRAIGHT_PIXELS), (0, 0))) for x in (depth, valid))
    # Starts of the pixels that the changes before and after an edge join.
    starts = (0, STRAIGHT_PIXELS, STRAIGHT_PIXELS + 1, 2 * STRAIGHT_PIXELS + 1)
    (far, near, next_near, next_far), seen = ([x[k : k + count] for k in starts] for x in (d, v))
    before, across, after = near - far, next_near - near, next_far - next_near
    bend = jnp.maximum(jnp.abs(after - before), jnp.abs(across - (before + after) / (2 * STRAIGHT_PIXELS)))
    return seen[0] & seen[1] & seen[2] & seen[3] & (bend < STRAIGHT_TOLERANCE * jnp.minimum(near, next_near))
