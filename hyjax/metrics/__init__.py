"""How near a picture comes to another: PSNR, SSIM, LPIPS.

They take display values in [0, 1], work under `jit`, `grad` and `vmap`, and check values unless jax is tracing.
"""

from hyjax.metrics.lpips import lpips, lpips_distance, lpips_distance_map, lpips_features, lpips_map
from hyjax.metrics.psnr import psnr
from hyjax.metrics.ssim import ssim, ssim_map
from hyjax.metrics.weights import LpipsWeights, load_lpips

__all__ = [
    "LpipsWeights",
    "load_lpips",
    "lpips",
    "lpips_distance",
    "lpips_distance_map",
    "lpips_features",
    "lpips_map",
    "psnr",
    "ssim",
    "ssim_map",
]
