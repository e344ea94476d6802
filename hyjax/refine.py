"""The cascade where something is unknown, and the shadow pass."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hyjax.cascade import cascade
from hyjax.lights import TINY
from hyjax.pyramid import cell_pixels, downsample
from hyjax.schedule import Schedule

# Weight below which a hole counts as too far from any surface to be filled from its surroundings.
HOLE_FLOOR = 1e-3


@jax.jit
def cascade_known(
    y: Float[Array, "h w c"], known: Bool[Array, "h w k"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w c"]:
    """`cascade` that treats values outside `known` as missing instead of taking them for real.

    Diffuses (w y, w) with w = 1 on what is known and divides, so that a hole takes on its surroundings' value
    instead of darkening them. Where nothing known is within reach the mean of all that is known stands in.

    Args:
        y: the filter to repair.
        known: where its values mean anything; one channel for all of y's or one for each.
        guide: see `cascade`.
        schedule: see `cascade`.

    Source: Knutsson and Westin, *Normalized and differential convolution*, CVPR 1993.
    """
    weight, channels = known.astype(y.dtype), y.shape[-1]
    weighted = jnp.concatenate([y * weight, weight], axis=-1)
    # Summed over the coarsest cells, which the cascade needs anyhow: XLA's CPU backend is slow to sum over pixels.
    factor = schedule.levels[0].factor
    pixels = jnp.asarray(cell_pixels((y.shape[0], y.shape[1]), factor), y.dtype)
    total = jnp.sum(downsample(weighted, factor) * pixels, axis=(0, 1))
    mean = total[:channels] / jnp.maximum(total[channels:], TINY)
    diffused = cascade(weighted, guide, schedule)
    reached = diffused[..., channels:]
    floor = HOLE_FLOOR * (1.0 - reached)  # nothing where everything is known
    return (diffused[..., :channels] + floor * mean) / (reached + floor)


@jax.jit
def shadow_pass(
    raw: Float[Array, "h w c"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w c"]:
    """Refine visibility by few steps at high resolution, which softens shadows and keeps their shape.

    The same diffusion as for the shading: the guide keeps a shadow from leaking onto the next object.

    Args:
        raw: visibility, in [0, 1].
        guide: as for `cascade`.
        schedule: few steps at factor 1 or 2, such as `Schedule.preset("shadow")`.
    """
    return cascade(raw, guide, schedule)


@jax.jit
def fill_visibility(
    raw: Float[Array, "h w l"], known: Bool[Array, "h w l"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w l"]:
    """Visibility where the mesh does not tell it, from the surroundings, by the coarse levels of a schedule.

    Nothing is known in holes, nor of a light on surfaces turned away from it. What lies there in truth may well be
    lit or shadowed as its neighbours are, and must not bring light (or darkness) of its own into the picture.

    Args:
        raw: visibility, a channel for each light.
        known: where it means anything.
        guide: as for `cascade`.
        schedule: as for the shading; its finest level is left out, since only the coarse ones reach across holes.
    """
    coarse = dataclasses.replace(schedule, levels=schedule.levels[:-1] or schedule.levels)
    return jnp.where(known, raw, cascade_known(raw, known, guide, coarse))
