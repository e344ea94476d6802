"""What a schedule is judged on: frames of a capture, lit on a rough mesh, with the filter they should have had."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from hyjax.color import to_display
from hyjax.losses import filter_loss
from hyjax.refine import cascade_known
from hyjax.schedule import Schedule
from hyjax.tuning.result import Scores


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One frame, ready to be refined and judged.

    Attributes:
        shading: what the cascade repairs: lux of each light on the rough mesh, without shadows.
        known: where the rough mesh has a surface.
        guide: features of the frame.
        frame: camera picture, linear.
        colors: from lights to the filter: each light's colour, divided by the reference illuminance.
        target: the filter as it should be, linear.
        valid: where `target` means anything.
    """

    shading: Float[Array, "h w l"]
    known: Bool[Array, "h w 1"]
    guide: Float[Array, "h w f"]
    frame: Float[Array, "h w 3"]
    colors: Float[Array, "l 3"]
    target: Float[Array, "h w 3"]
    valid: Bool[Array, "h w"]


def mix(channels: Float[Array, "h w l"], colors: Float[Array, "l 3"]) -> Float[Array, "h w 3"]:
    """A channel for each light → the filter."""
    return sum(channels[..., k, None] * colors[k] for k in range(colors.shape[0]))  # type: ignore[return-value]


@jax.jit
def refined_filter(case: Case, schedule: Schedule) -> Float[Array, "h w 3"]:
    """The filter that a schedule makes of the case: exactly what `relight` runs."""
    return mix(cascade_known(case.shading, case.known, case.guide, schedule), case.colors)


@jax.jit
def _judge(case: Case, relight_filter: Float[Array, "h w 3"]) -> tuple[Array, Array, Array]:
    loss = filter_loss(relight_filter, case.target, case.frame, case.valid)
    return loss, to_display(relight_filter * case.frame), to_display(case.target * case.frame)


def scores(cases: Sequence[Case], filters: Sequence[Float[Array, "h w 3"]]) -> Scores:
    """Loss, PSNR and SSIM of the relit frames, where the target is known; the mean over all cases."""
    rows = []
    for case, relight_filter in zip(cases, filters, strict=True):
        loss, relit, target = (np.asarray(x) for x in _judge(case, relight_filter))
        valid = np.asarray(case.valid)
        with np.errstate(divide="ignore"):  # equal pictures: infinite PSNR
            psnr = peak_signal_noise_ratio(target[valid], relit[valid], data_range=1.0)
        _, ssim = structural_similarity(target, relit, channel_axis=-1, data_range=1.0, full=True)
        rows.append((float(loss), float(psnr), float(ssim[valid].mean())))
    return Scores(*(float(x) for x in np.mean(rows, axis=0)))
