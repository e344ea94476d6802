"""Guided depth super-resolution of Metzger et al., CVPR 2023, in torch, written from the paper.

Batch × channel × row × column, in whatever precision the tensors come in.
"""

from typing import Any

from extras import need

need("torch")
import torch


def bicubic(source: Any, factor: int) -> Any:
    """Where the iteration starts."""
    return torch.nn.functional.interpolate(source, scale_factor=factor, mode="bicubic", align_corners=False)


def coefficients(features: Any, kappa: float) -> tuple[Any, Any]:
    """1 / (1 + (d/κ)²) between vertical and horizontal neighbours; d is the mean over channels of |difference|."""
    return tuple(
        1.0 / (1.0 + (features.diff(dim=axis).abs().mean(dim=1, keepdim=True) / kappa) ** 2) for axis in (2, 3)
    )


def diffuse(y: Any, vertical: Any, horizontal: Any, lam: float) -> Any:
    """One step: what a pixel loses to a neighbour this one gains."""
    pad = torch.nn.functional.pad
    down, right = lam * vertical * y.diff(dim=2), lam * horizontal * y.diff(dim=3)
    return (
        y + pad(down, (0, 0, 0, 1)) - pad(down, (0, 0, 1, 0)) + pad(right, (0, 1, 0, 0)) - pad(right, (1, 0, 0, 0))
    )


def adjust(y: Any, source: Any, known: Any, factor: int) -> Any:
    """Times the ratio of the source to the cell's mean, which is 1 where the source is unknown."""
    ratio = source / (torch.nn.functional.avg_pool2d(y, factor) + 1e-8)
    ratio = torch.where(known, ratio, torch.ones_like(ratio))
    return y * torch.nn.functional.interpolate(ratio, scale_factor=factor, mode="nearest")


def super_resolve(
    source: Any, known: Any, features: Any, *, factor: int, steps: int, kappa: float, lam: float = 0.24
) -> Any:
    """Diffuse and adjust in turns, from the bicubic interpolation."""
    vertical, horizontal = coefficients(features, kappa)
    y = bicubic(source, factor)
    for _ in range(steps):
        y = adjust(diffuse(y, vertical, horizontal, lam), source, known, factor)
    return y
