"""Registry of metrics, which evaluation, tuning, tables and reports read: no other file lists their names.

A new metric is a file with its function and a line in `METRICS`, or from outside the package `register_metric`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

from jaxtyping import Array, Float

from hyjax.metrics.lpips import lpips, lpips_distance_map, lpips_features
from hyjax.metrics.psnr import decibels, psnr, squared_error_map
from hyjax.metrics.ssim import ssim, ssim_map
from hyjax.metrics.weights import LpipsWeights
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class Metric:
    """Metric of two pictures, display values in [0, 1].

    Attributes:
        function: `function(image, reference, valid=mask)`, a scalar; runs under `jit`. Of a learned metric:
            `function(image, reference, weights)`.
        map: `map(image, reference)`, a value per pixel, whose mean over a region is the region's score. Of a
            learned metric: `map(image, prepare(reference, weights))`.
        digits: decimals in tables.
        better: whether higher or lower values are better.
        label: heading in tables, with the unit.
        pooled: function from the mean of the map to the score.
        prepare: of a learned metric: everything that depends on the reference and the weights alone. Tuning, which
            has no weights, leaves learned metrics out.
    """

    function: Callable[..., Float[Array, ""]]
    map: Callable[..., Float[Array, "h w"]]
    digits: int
    better: Literal["higher", "lower"]
    label: str
    pooled: Callable[[float], float] = float
    prepare: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        if self.better not in ("higher", "lower"):
            raise InputError(f"better: must be higher or lower, got {self.better!r}")

    @property
    def column(self) -> str:
        """Label as a column of a CSV file: `psnr_db`."""
        return self.label.lower().replace(" ", "_")


def _lpips_map(image: Float[Array, "h w 3"], prepared: tuple[Any, LpipsWeights]) -> Float[Array, "h w"]:
    features, weights = prepared
    return lpips_distance_map(lpips_features(image, weights), features, weights, shape=image.shape[:2])


METRICS: dict[str, Metric] = {
    "lpips": Metric(
        function=lpips,
        map=_lpips_map,
        digits=4,
        better="lower",
        label="LPIPS",
        prepare=lambda reference, weights: (lpips_features(reference, weights), weights),
    ),
    "psnr": Metric(psnr, squared_error_map, digits=2, better="higher", label="PSNR dB", pooled=decibels),
    "ssim": Metric(ssim, ssim_map, digits=4, better="higher", label="SSIM"),
}
"""Metrics by name, in the order of tables."""


def register_metric(name: str, metric: Metric) -> None:
    """Add a metric to evaluation, tuning scores and reports.

    >>> import jax.numpy as jnp
    >>> def error(image, reference, *, valid=None):
    ...     return jnp.mean(jnp.abs(image - reference), where=None if valid is None else valid[..., None])
    >>> def error_map(image, reference):
    ...     return jnp.mean(jnp.abs(image - reference), axis=-1)
    >>> register_metric("mae", Metric(error, error_map, digits=4, better="lower", label="MAE"))
    >>> METRICS.pop("mae").column
    'mae'

    Args:
        name: key in rows of results.
        metric: its functions, and how it is shown.

    Raises:
        InputError: the name is taken, or no identifier, or the metric is no `Metric`.
    """
    if not isinstance(metric, Metric):
        raise InputError(f"metric {name}: must be a Metric, got {type(metric).__name__}")
    if not name.isidentifier() or name == "loss":
        raise InputError(f"name: a metric's must be an identifier other than loss, got {name!r}")
    if name in METRICS:
        raise InputError(f"name: there is a metric {name} already")
    METRICS[name] = metric


def plain_metrics() -> dict[str, Metric]:
    """Metrics without weights, by name.

    >>> list(plain_metrics())
    ['psnr', 'ssim']
    """
    return {name: metric for name, metric in METRICS.items() if metric.prepare is None}
