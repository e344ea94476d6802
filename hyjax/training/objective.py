"""Training loss of a guide: guided super-resolution, and conductances against true borders.

The super-resolution is that of Metzger et al., CVPR 2023, with the paper's changes: the network sees the frame
alone, and the diffused picture has three channels. It runs through single-level diffusion, as they train, or
through the cascade, as the pipeline will run it.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from hyjax.core.diffusion import edge_stopping, guide_distance
from hyjax.core.pyramid import max_pool, upsample
from hyjax.core.schedule import Schedule
from hyjax.core.stencil import Edges
from hyjax.core.superresolution import coarsen, diffuse_adjusted, diffuse_adjusted_forward, super_resolve
from hyjax.training.settings import TrainSettings
from hyjax.training.targets import Sample, borders, lit, mean_over, random_shading, tinted_depth

BORDER_BALANCE = 4.0
"""Weight of an edge on a border over one inside an object, as a gap in a border empties the object."""


class Losses(NamedTuple):
    """Parts of the loss, means over the batch."""

    depth: Float[Array, ""]
    shading: Float[Array, ""]
    border: Float[Array, ""]


def schedule_of(settings: TrainSettings, kappa: Float[Array, ""]) -> Schedule:
    """Schedule of the cascade in training, with the learned κ at every level."""
    schedule = Schedule.preset(settings.schedule)
    return dataclasses.replace(
        schedule, levels=tuple(dataclasses.replace(level, kappa=kappa) for level in schedule.levels)
    )


def batch_losses(
    features: Float[Array, "b h w f"],
    log_kappa: Float[Array, ""],
    batch: Sample,
    key: Key[Array, ""],
    factor_index: Int[Array, ""],
    settings: TrainSettings,
) -> Losses:
    """Mean losses of a batch, all fields of which have a leading axis.

    Args:
        features: the network's guide of each picture.
        log_kappa: logarithm of the learned κ.
        batch: pictures with depth.
        key: of tints, lamps and step counts.
        factor_index: of the sources' factor in `settings.factors`.
        settings: weights of zero leave their part out.
    """
    step_key, sample_key = jax.random.split(key)
    uncounted = jax.random.randint(step_key, (), 0, max(settings.steps_without_gradient, 1))
    keys = jax.random.split(sample_key, features.shape[0])

    def losses(features: Array, sample: Sample, key: Key[Array, ""]) -> tuple[Losses, Array]:
        depth_key, shading_key = jax.random.split(key)
        depth = shading = border = jnp.zeros(())
        shaded = lit(sample)

        def error(target: Array, valid: Array) -> Array:
            """L1 between a super-resolved picture and the true one, over the valid pixels."""
            resolvers = [
                lambda y, guide, factor=factor: resolve(y, valid, guide, log_kappa, factor, uncounted, settings)
                for factor in settings.factors
            ]
            resolved = jax.lax.switch(factor_index, resolvers, target, features)
            return jnp.mean(mean_over(jnp.abs(resolved - target), valid))

        if settings.depth_weight:
            depth = error(tinted_depth(sample, depth_key), sample.valid)
        if settings.shading_weight:
            shading = error(random_shading(sample, shading_key), shaded)
        if settings.border_weight:
            border = border_loss(features, log_kappa, sample, schedule_of(settings, jnp.exp(log_kappa)))
        return Losses(depth, shading, border), jnp.any(shaded).astype(features.dtype)

    parts, shaded = jax.vmap(losses)(features, batch, keys)
    # Crops without normals say nothing of shading.
    shading = jnp.sum(parts.shading * shaded) / jnp.maximum(jnp.sum(shaded), 1.0)
    return Losses(jnp.mean(parts.depth), shading, jnp.mean(parts.border))


def total(losses: Losses, settings: TrainSettings) -> Float[Array, ""]:
    """Weighted sum of the losses."""
    return (
        settings.depth_weight * losses.depth
        + settings.shading_weight * losses.shading
        + settings.border_weight * losses.border
    )


def resolve(
    target: Float[Array, "h w c"],
    valid: Bool[Array, "h w"],
    features: Float[Array, "h w f"],
    log_kappa: Float[Array, ""],
    factor: int,
    uncounted: Int[Array, ""],
    settings: TrainSettings,
) -> Float[Array, "h w c"]:
    """Coarsen a picture by `factor` and super-resolve it again under the guide."""
    source, known = coarsen(target, valid, factor)
    if settings.through == "cascade":
        schedule = schedule_of(settings, jnp.exp(log_kappa))
        return super_resolve(source, known, features, schedule, factor, adjusted=settings.adjusted)
    edges = edge_stopping(guide_distance(features), jnp.exp(log_kappa))
    y = upsample(source, factor, target.shape[:2])
    if not settings.adjusted:
        known = jnp.zeros_like(known)
    y = diffuse_adjusted_forward(y, edges, settings.lam, uncounted, source, known, factor)
    return diffuse_adjusted(y, edges, jnp.full(settings.steps_with_gradient, settings.lam), source, known, factor)


def border_loss(
    features: Float[Array, "h w f"], log_kappa: Float[Array, ""], sample: Sample, schedule: Schedule
) -> Float[Array, ""]:
    """Cross-entropy between conductances and true borders, at full size and at the schedule's levels.

    1 − c = d²/(κ² + d²) of Eq. 3 is the logistic function of log d²/κ²: the guide's distance is a border detector.
    Levels are pooled as the cascade pools; there a border need not be hit to the pixel, which no sensor's depth map
    does either.
    """
    distance = guide_distance(features)
    border, known = borders(sample)
    losses = []
    for factor in (*(level.factor for level in schedule.levels), 1):
        pooled = max_pool(distance, factor)
        is_border = max_pool(border, factor)
        # A cell without a border is known to be without only if all of it is known.
        unknown = max_pool(jax.tree.map(lambda k: 1.0 - k, known), factor)
        losses.append(_cross_entropy(pooled, is_border, unknown, log_kappa))
    return sum(losses, jnp.zeros(())) / len(losses)


def _cross_entropy(distance: Edges, border: Edges, unknown: Edges, log_kappa: Array) -> Array:
    total, count = jnp.zeros(()), jnp.zeros(())
    for squared, is_border, is_unknown in zip(distance, border, unknown, strict=True):
        logit = jnp.log(squared + 1e-12) - 2.0 * log_kappa
        loss = jax.nn.softplus(logit) - is_border * logit
        weight = BORDER_BALANCE * is_border + (1.0 - is_border) * (1.0 - is_unknown)
        total, count = total + jnp.sum(weight * loss), count + jnp.sum(weight)
    return total / jnp.maximum(count, 1.0)
