"""The LPIPS that everybody quotes, in torch, with weights of ours: nothing is downloaded."""

import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from extras import need

from hyjax.metrics import LpipsWeights


def torch_lpips(weights: LpipsWeights, *, spatial: bool) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """`lpips.LPIPS` as a function of two pictures, H x W x 3 in [0, 1]; skips the test where it is missing."""
    need("torch", "lpips")
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import_torchvision(torch)
        import lpips

        model = lpips.LPIPS(
            net=weights.net, version="0.1", pretrained=False, pnet_rand=True, spatial=spatial, verbose=False
        )
    convolutions = [m for m in model.net.modules() if isinstance(m, torch.nn.Conv2d)]
    with torch.no_grad():
        for layer, kernel, bias in zip(convolutions, weights.kernels, weights.biases, strict=True):
            layer.weight.copy_(torch.tensor(np.asarray(kernel).transpose(3, 2, 0, 1)))
            layer.bias.copy_(torch.tensor(np.asarray(bias)))
        for head, channels in zip(model.lins, weights.heads, strict=True):
            head.model[-1].weight.copy_(torch.tensor(np.asarray(channels))[None, :, None, None])

    def distance(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
        pictures = (
            torch.tensor(2.0 * p.astype(np.float32) - 1.0).permute(2, 0, 1)[None] for p in (image, reference)
        )
        with torch.no_grad():
            return model(*pictures).numpy().squeeze()

    return distance


def import_torchvision(torch: Any) -> None:
    """Its networks alone are wanted, which do without the operators that a wheel for other devices lacks."""
    need("torchvision")
    try:
        import torchvision
    except RuntimeError:
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        for operator in (
            "nms(Tensor a, Tensor b, float c) -> Tensor",
            "qnms(Tensor a, Tensor b, float c) -> Tensor",
        ):
            torch.library.define(f"torchvision::{operator.split('(')[0]}", operator[operator.index("(") :])
        import torchvision  # noqa: F401
