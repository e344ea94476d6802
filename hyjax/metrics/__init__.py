"""Similarity of two pictures: PSNR, SSIM, LPIPS, and the registry to which more can be added.

Metrics take display values in [0, 1], work under `jit`, `grad` and `vmap`, and check values unless jax is tracing.
"""

from hyjax.metrics import losses
from hyjax.metrics.lpips import lpips, lpips_distance, lpips_distance_map, lpips_features, lpips_map
from hyjax.metrics.psnr import decibels, psnr, squared_error_map
from hyjax.metrics.registry import METRICS, Metric, plain_metrics, register_metric
from hyjax.metrics.ssim import ssim, ssim_map
from hyjax.metrics.weights import LpipsWeights, load_lpips

__all__ = [
    "METRICS",
    "LpipsWeights",
    "Metric",
    "decibels",
    "load_lpips",
    "losses",
    "lpips",
    "lpips_distance",
    "lpips_distance_map",
    "lpips_features",
    "lpips_map",
    "plain_metrics",
    "psnr",
    "register_metric",
    "squared_error_map",
    "ssim",
    "ssim_map",
]
