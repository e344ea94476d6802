"""Cascades of pictures with unknown or doubtful values, and the shadow pass."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hyjax.core.cascade import cascade
from hyjax.core.pyramid import cell_pixels, downsample
from hyjax.core.schedule import Schedule
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.geometry import TINY

FILLING_PRESET = "hyjax"
"""Preset that fills what is unknown."""
HOLE_FLOOR = 1e-3
"""Weight below which a hole counts as too far from any surface to be filled from its surroundings."""


@checked_arguments
def cascade_known(
    y: Float[Array, "h w c"],
    confidence: Float[Array, "h w k"] | Bool[Array, "h w k"],
    guide: Float[Array, "h w f"],
    schedule: Schedule | str,
) -> Float[Array, "h w c"]:
    """Cascade with values weighted by their confidence (normalised convolution).

    Diffuses (w y, w) with the confidence w and divides, so that a hole (w = 0) takes on its surroundings' value
    instead of darkening them. Where no known value is within reach their overall mean stands in; zero without
    any. Values and confidences that are not finite count as unknown, and affect nothing beyond their pixel.

    >>> light, guide = jnp.zeros((8, 8, 1)).at[:, :4].set(5.0), jnp.zeros((8, 8, 3))
    >>> refined = cascade_known(light, light > 0, guide, Schedule.uniform([(4, 8), (2, 8)]))
    >>> round(float(refined.min()), 3), round(float(refined.max()), 3)
    (5.0, 5.0)

    Args:
        y: the filter to repair.
        confidence: how far its values can be trusted, in [0, 1], or whether at all; one channel for all of y's or
            one for each.
        guide: see `cascade`.
        schedule: see `cascade`. Its fidelity holds (w y, w) alike: confident pixels keep their value, unknown
            ones have none to keep.

    Raises:
        InputError: sizes that differ, or a schedule that cannot be run; see `cascade`.

    Source: Knutsson and Westin, *Normalized and differential convolution*, CVPR 1993.
    """
    schedule = Schedule.of(schedule).check(dtype=y.dtype)
    if confidence.shape[-1] not in (1, y.shape[-1]):
        raise InputError(f"confidence: must have 1 channel or {y.shape[-1]} as the filter, got {confidence.shape}")
    return _cascade_known(y, confidence, guide, schedule)


@jax.jit
def _cascade_known(
    y: Float[Array, "h w c"],
    confidence: Float[Array, "h w k"] | Bool[Array, "h w k"],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
) -> Float[Array, "h w c"]:
    weight, channels = confidence.astype(y.dtype), y.shape[-1]
    usable = jnp.isfinite(y)
    if weight.shape[-1] == 1:
        usable = _all_channels(usable)
    weight = jnp.where(usable & jnp.isfinite(weight) & (weight > 0), jnp.minimum(weight, 1.0), 0.0)
    weighted = jnp.concatenate([jnp.where(weight > 0, y, 0.0) * weight, weight], axis=-1)
    # Summed over the coarsest cells, which the cascade needs anyhow: XLA's CPU backend is slow to sum over pixels.
    factor = schedule.levels[0].factor
    pixels = jnp.asarray(cell_pixels((y.shape[0], y.shape[1]), factor), jnp.float32)
    # In single precision at least: a sum over a picture overflows half precision.
    total = jnp.sum((downsample(weighted, factor) * pixels).astype(jnp.promote_types(y.dtype, jnp.float32)), (0, 1))
    mean = (total[:channels] / jnp.maximum(total[channels:], TINY)).astype(y.dtype)
    diffused = cascade(weighted, guide, schedule)
    reached = diffused[..., channels:]
    floor = jnp.maximum(HOLE_FLOOR * (1.0 - reached), 0.0)  # nothing where everything is known
    divisor = reached + floor
    return (diffused[..., :channels] + floor * mean) / jnp.where(divisor > 0, divisor, 1.0)


def _all_channels(x: Bool[Array, "h w c"]) -> Bool[Array, "h w 1"]:
    """Logical and over channels, one by one, as XLA's CPU reductions over short axes are slow."""
    together = x[..., :1]
    for k in range(1, x.shape[-1]):
        together &= x[..., k : k + 1]
    return together


@checked_arguments
def shadow_pass(
    raw: Float[Array, "h w c"], guide: Float[Array, "h w f"], schedule: Schedule | str
) -> Float[Array, "h w c"]:
    """Refine visibility by few steps at high resolution, which softens shadows and keeps their shape.

    The same diffusion as for the shading: the guide keeps a shadow from leaking onto the next object.

    >>> lit = jnp.ones((8, 8, 1)).at[2:6, 2:6].set(0.0)
    >>> soft = shadow_pass(lit, jnp.zeros((8, 8, 3)), Schedule.preset("shadow"))
    >>> bool((soft >= 0).all()) and float(soft[3, 3, 0]) < float(soft[0, 0, 0])
    True

    Args:
        raw: visibility, in [0, 1].
        guide: as for `cascade`.
        schedule: few steps at factor 1 or 2, such as `Schedule.preset("shadow")`.

    Raises:
        InputError: see `cascade`.
    """
    return cascade(raw, guide, schedule)


@checked_arguments
@jax.jit
def fill_visibility(
    raw: Float[Array, "h w l"], known: Bool[Array, "h w l"], guide: Float[Array, "h w f"]
) -> Float[Array, "h w l"]:
    """Fill visibility that the mesh leaves unknown from its surroundings, by the preset `hyjax`.

    Nothing is known in holes, nor of a light on surfaces turned away from it. What lies there in truth may well be
    lit or shadowed as its neighbours are, and must not bring light (or darkness) of its own into the picture.

    >>> raw, known = jnp.ones((8, 8, 1)), jnp.ones((8, 8, 1), bool).at[3, 3].set(False)
    >>> filled = fill_visibility(raw.at[3, 3].set(0.0), known, jnp.zeros((8, 8, 3)))
    >>> round(float(filled[3, 3, 0]), 3)
    1.0

    Args:
        raw: visibility, a channel for each light.
        known: where it means anything.
        guide: as for `cascade`.

    Raises:
        InputError: see `cascade`.
    """
    known = known & jnp.isfinite(raw)
    return jnp.where(known, raw, cascade_known(raw, known, guide, Schedule.preset(FILLING_PRESET)))
