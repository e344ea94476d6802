"""Cases: frames of a capture, lit on a rough mesh, with the filter that they should have had."""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from hyjax.core.schedule import Schedule
from hyjax.light.color import to_display
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.metrics import Metric, plain_metrics
from hyjax.metrics.losses import filter_loss
from hyjax.pipeline import refine_illuminance


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One frame, ready to be refined and judged.

    Attributes:
        shaded: light on the rough mesh, without shadows: what the cascade repairs.
        frame: camera picture, linear.
        target: the filter as it should be, linear.
        valid: where `target` means anything.
    """

    shaded: Shaded
    guide: Float[Array, "h w f"]
    frame: Float[Array, "h w 3"]
    target: Float[Array, "h w 3"]
    valid: Bool[Array, "h w"]


def filter_colors(shaded: Shaded) -> Float[Array, "l 3"]:
    """Relight filter of one lux of each light."""
    return shaded.colors / shaded.reference_lux


def raw_filter(shaded: Shaded) -> Float[Array, "h w 3"]:
    """Relight filter before the refinement, without shadows."""
    return mix_channels(shaded.illuminance, filter_colors(shaded))


@jax.jit
def refined_filter(case: Case, schedule: Schedule) -> Float[Array, "h w 3"]:
    """Relight filter of a case after a schedule, by the function that `relight` runs."""
    return mix_channels(refine_illuminance(case.shaded, case.guide, schedule), filter_colors(case.shaded))


@functools.partial(jax.jit, static_argnames="metrics")
def _scores(case: Case, relight_filter: Float[Array, "h w 3"], metrics: tuple[Metric, ...]) -> list[Array]:
    relit, target = to_display(relight_filter * case.frame), to_display(case.target * case.frame)
    values = [metric.function(relit, target, valid=case.valid) for metric in metrics]
    return [filter_loss(relight_filter, case.target, case.frame, case.valid), *values]


def scores(cases: Sequence[Case], filters: Sequence[Float[Array, "h w 3"]]) -> dict[str, float]:
    """Loss and metrics by name of the relit frames, where the target is known; the mean over all cases."""
    metrics = plain_metrics()
    rows = [_scores(case, f, tuple(metrics.values())) for case, f in zip(cases, filters, strict=True)]
    return dict(zip(("loss", *metrics), np.mean(np.asarray(rows, float), axis=0).tolist()))
