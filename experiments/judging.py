"""Scores of pictures against a target, over the whole and by kind of pixel; means and intervals over frames."""

import dataclasses
import functools
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy import ndimage, stats

from hyjax.light.gbuffer import GBuffer
from hyjax.metrics import METRICS, LpipsWeights, Metric, load_lpips
from hyjax.util.errors import InputError

REGIONS = ("all", "holes", "silhouettes", "elsewhere")
SILHOUETTE = 6 / 512  # of the picture's height: how near to a depth jump counts as beside it
JUMP = 0.05  # of the depth, between neighbouring pixels
SMALLEST_SIZE = 64  # pixels a side
SMALLEST_REGION = 1e-3  # share of the picture below which a region says nothing

Image = Float[Array, "h w 3"]
Regions = Mapping[str, Bool[np.ndarray, "h w"]]


def check_size(size: int) -> None:
    """Raise `InputError` for pictures too small for the coarsest level and for LPIPS."""
    if size < SMALLEST_SIZE:
        raise InputError(f"size: must be at least {SMALLEST_SIZE} pixels a side, got {size}")


def weights_or_none(path: Path | None) -> LpipsWeights | None:
    """Weights of LPIPS; without any it is left out, unless a file was asked for."""
    try:
        return load_lpips(path)
    except InputError as error:
        if path is not None:
            raise
        print(f"LPIPS is left out ({error})", file=sys.stderr)
        return None


def regions(rough: GBuffer, accurate: GBuffer) -> Regions:
    """Regions of a picture by the fault of the rough surface there.

    Returns:
        `all`; and disjoint: `holes`, where the rough mesh has no surface; `silhouettes`, beside a depth jump of
        either surface (the rim of a hole is none); `elsewhere`.
    """
    holes = ~np.asarray(rough.hit)
    beside = beside_jump(np.asarray(rough.depth)) | beside_jump(np.asarray(accurate.depth))
    near = beside & ~holes
    return {"all": np.ones_like(holes), "holes": holes, "silhouettes": near, "elsewhere": ~(holes | near)}


def judge(
    pictures: Mapping[str, Image],
    target: Image,
    regions: Regions,
    weights: LpipsWeights | None,
    valid: Bool[np.ndarray, "h w"] | None = None,
) -> dict[str, dict[str, dict[str, float]]]:
    """Scores of pictures against a target, by region.

    Where the target is not valid the pictures are given its values: nothing there counts for or against them, also
    not in the surroundings that SSIM and LPIPS look at.

    Args:
        pictures: display values by name.
        target: display values.
        regions: masks by name.
        weights: of learned metrics; None leaves these out.
        valid: where the target counts; None for everywhere.

    Returns:
        Picture → region → metric, from the mean of the metric's map over the region. Regions smaller than
        `SMALLEST_REGION` of the picture are left out.
    """
    valid = np.ones(target.shape[:2], bool) if valid is None else valid
    metrics = {name: m for name, m in METRICS.items() if m.prepare is None or weights is not None}
    prepared = tuple(target if m.prepare is None else m.prepare(target, weights) for m in metrics.values())
    # All at once keeps an accelerator busy; XLA's CPU backend is faster with one after the other.
    together = jax.default_backend() != "cpu"
    stacked = jnp.stack([jnp.asarray(picture) for picture in pictures.values()])
    inputs = target, jnp.asarray(valid), prepared, tuple(metrics.values())
    if together:
        maps = [np.asarray(m) for m in _maps_of_all(stacked, *inputs)]
    else:
        maps = [np.stack(m) for m in zip(*(_maps(picture, *inputs) for picture in stacked))]
    scores: dict[str, dict[str, dict[str, float]]] = {name: {} for name in pictures}
    for region, mask in regions.items():
        counted = mask & valid
        if counted.mean() < SMALLEST_REGION:
            continue
        for k, name in enumerate(pictures):
            means = (m[k][counted].mean(dtype=np.float64) for m in maps)
            scores[name][region] = {
                metric: float(metrics[metric].pooled(mean)) for metric, mean in zip(metrics, means)
            }
    return scores


@functools.partial(jax.jit, static_argnames="metrics")
def _maps(
    picture: Image, target: Image, valid: Bool[Array, "h w"], prepared: tuple[Any, ...], metrics: tuple[Metric, ...]
) -> tuple[Float[Array, "h w"], ...]:
    """Map of each metric, against the target as `prepared` for it."""
    compared = jnp.where(valid[..., None], picture, target)
    return tuple(metric.map(compared, own) for metric, own in zip(metrics, prepared, strict=True))


@functools.partial(jax.jit, static_argnames="metrics")
def _maps_of_all(
    pictures: Float[Array, "n h w 3"],
    target: Image,
    valid: Bool[Array, "h w"],
    prepared: tuple[Any, ...],
    metrics: tuple[Metric, ...],
) -> tuple[Float[Array, "n h w"], ...]:
    return jax.vmap(lambda picture: _maps(picture, target, valid, prepared, metrics))(pictures)


def beside_jump(depth: Float[np.ndarray, "h w"], reach: int | None = None) -> Bool[np.ndarray, "h w"]:
    """Pixels within `reach` of a jump between two depths; by default `SILHOUETTE` of the height.

    Depth 0 is none: nothing jumps to it.
    """
    jump = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        d, j = np.moveaxis(depth, axis, 0), np.moveaxis(jump, axis, 0)
        nearer = np.minimum(d[1:], d[:-1])
        far = (nearer > 0) & (np.abs(np.diff(d, axis=0)) > JUMP * nearer)
        j[1:] |= far
        j[:-1] |= far
    reach = max(1, round(SILHOUETTE * depth.shape[0])) if reach is None else reach
    return ndimage.binary_dilation(jump, iterations=reach) if reach else jump


FEWEST_VALUES = 6
"""Values below which no interval is told: the range of five holds the median with less than 95 %."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """A mean over frames.

    Attributes:
        mean: of the values.
        half: half width of its 95 % interval; None if there are too few values to tell. It is of other frames of
            the same walk, not of other rooms.
        count: how many values.
    """

    mean: float
    half: float | None
    count: int

    def text(self, digits: int) -> str:
        """Such as `0.123 ±0.004`."""
        half = "" if self.half is None else f" ±{self.half:.{digits}f}"
        return f"{self.mean:.{digits}f}{half}"


def summarise(values: Sequence[float | None]) -> Summary | None:
    """Mean and interval of the values that there are, in the frames' order; None if there is none.

    Neighbouring frames show nearly the same, so n of them say as much as n (1 − ρ)/(1 + ρ) independent ones
    would, but no less than one; ρ is the correlation of each with the next. Of strongly correlated values the
    interval is a guide to their spread rather than a bound.

    Source: Wilks, *Statistical methods in the atmospheric sciences*, section 5.2.4 (effective sample size).
    """
    there = np.array([v for v in values if v is not None], dtype=float)
    if not there.size:
        return None
    mean, half = float(there.mean()), None
    if there.size > 1:
        spread = float(there.std(ddof=1))
        half = float(stats.t.ppf(0.975, there.size - 1) * spread / math.sqrt(_effective_size(there)))
    return Summary(mean, half, there.size)


@dataclasses.dataclass(frozen=True)
class Middle:
    """A median over frames.

    Attributes:
        median: of the values.
        low, high: bounds of its 95 % interval; None if there are too few values to tell. It is of other frames of
            the same walk, not of other rooms.
    """

    median: float
    low: float | None
    high: float | None

    def text(self, digits: int, sign: str = "") -> str:
        """Such as `0.123 (0.119 to 0.131)`; with `sign` "+" also positive numbers have one."""
        number = f"{sign}.{digits}f"
        bounds = "" if self.low is None else f" ({self.low:{number}} to {self.high:{number}})"
        return f"{self.median:{number}}{bounds}"


def middle(values: Sequence[float | None]) -> Middle | None:
    """Median of the values that there are, in the frames' order, and its interval; None if there is none.

    The bounds are the values of rank n/2 ± 0.98 √n, with n as in `summarise`: they lie within the values, however
    strongly these are correlated.

    Source: Conover, *Practical nonparametric statistics*, section 3.2 (confidence interval of a quantile).
    """
    there = np.array([v for v in values if v is not None], dtype=float)
    if not there.size:
        return None
    median = float(np.median(there))
    if there.size < FEWEST_VALUES:
        return Middle(median, None, None)
    share = min(0.5, 0.98 / math.sqrt(_effective_size(there)))
    low, high = np.quantile(there, [0.5 - share, 0.5 + share])
    return Middle(median, float(low), float(high))


def _effective_size(values: np.ndarray) -> float:
    """Number of independent values that say as much; one at least."""
    centred = values - values.mean()
    total = float(centred @ centred)
    correlation = max(0.0, float(centred[1:] @ centred[:-1]) / total) if total > 0 else 0.0
    return max(1.0, values.size * (1.0 - correlation) / (1.0 + correlation))


def better_text() -> str:
    """Which values are better, for captions: `LPIPS: lower is better; ...`."""
    return "; ".join(f"{metric.label}: {metric.better} is better" for metric in METRICS.values())


def text_of(found: Middle | None, metric: str) -> str:
    """Median and interval with the metric's decimals; a dash if there is none."""
    return "–" if found is None else found.text(METRICS[metric].digits)


def pick(row: Mapping[str, Any], *keys: str) -> Any:
    """A value deep in a row; None if any of the keys is missing."""
    return functools.reduce(lambda found, key: None if found is None else found.get(key), keys, row)


def tuning_curve(scores: Sequence[Mapping[str, Any]]) -> dict[float, float]:
    """κ → mean PSNR on the tuning frames."""
    own = [row for row in scores if row["split"] == "tuning"]
    kappas = dict.fromkeys(row["kappa"] for row in own)
    return {kappa: float(np.mean([row["psnr"] for row in own if row["kappa"] == kappa])) for kappa in kappas}
