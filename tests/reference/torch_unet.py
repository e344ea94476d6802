"""The network as segmentation_models_pytorch builds it over timm's encoders, with random weights."""

import warnings
from typing import Any

import numpy as np
from extras import need

from reference.torch_lpips import import_torchvision

need("torch")
import torch


def torch_unet(encoder: str, features: int = 64, *, seed: int = 0, initial: bool = False) -> Any:
    """smp's Unet in inference mode; skips the test where timm or smp is missing.

    Args:
        encoder: name of timm's.
        features: channels of the result.
        seed: of all weights.
        initial: keep weights and statistics as they are before any training, instead of random ones.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import_torchvision(torch)
        need("timm", "segmentation_models_pytorch")
        import segmentation_models_pytorch as smp

        torch.manual_seed(seed)
        network = smp.Unet(f"tu-{encoder}", encoder_weights=None, classes=features)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d) and not initial:
            module.weight.data.uniform_(0.5, 1.5)
            module.bias.data.normal_(0, 0.3)
            module.running_mean.normal_(0, 0.3)
            module.running_var.uniform_(0.5, 2)
    if not initial:
        network.segmentation_head[0].bias.data.normal_()
    return network.eval()


def stages(network: Any, images: np.ndarray) -> list[np.ndarray]:
    """Feature maps of the encoder, fine to coarse, of the decoder, coarse to fine, and the result; B×H×W×C."""
    found: list[Any] = []
    hooks = [b.register_forward_hook(lambda *args: found.append(args[-1])) for b in network.decoder.blocks]
    with torch.inference_mode():
        pictures = channels_first(images)
        found += network.encoder(pictures)[1:]
        result = network(pictures)
    for hook in hooks:
        hook.remove()
    return [channels_last(x) for x in [*found, result]]


def channels_first(images: np.ndarray) -> Any:
    """B×H×W×C → torch's B×C×H×W."""
    return torch.tensor(np.asarray(images)).permute(0, 3, 1, 2).contiguous()


def channels_last(x: Any) -> np.ndarray:
    """torch's B×C×H×W → B×H×W×C."""
    return x.detach().permute(0, 2, 3, 1).numpy()
