"""The guide network with the same random weights here and in torch, for `bench_peers`."""

import copy
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from experiments.peers_report import CHANNELS_LAST, TORCH
from hyjax.guide import GuideNetwork
from hyjax.guide.weights import assign

FEATURES = 64


def same_networks(encoder: str, seed: int) -> tuple[GuideNetwork, Any]:
    """Ours and torch's with the same random weights, in inference mode; None for torch's, see `torch_network`."""
    theirs = torch_network(encoder, seed)
    network = GuideNetwork(encoder, FEATURES, rngs=nnx.Rngs(seed))
    if theirs is not None:
        state = {name: tensor.numpy() for name, tensor in theirs.state_dict().items()}
        assign(network, {n: a for n, a in state.items() if not n.endswith("tracked")}, "torch")
    network.eval()
    return network, theirs


def last_bias(network: GuideNetwork) -> Float[Array, "f"]:
    """Bias of the last layer, which the network's features have on top of a guide's."""
    return network.segmentation_head[0].bias[...]


def torch_network(encoder: str, seed: int) -> Any:
    """smp's Unet with random weights, in inference mode; None, and a word on stderr, where it is not installed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import torch

            _import_torchvision(torch)
            import segmentation_models_pytorch as smp
    except ImportError as error:
        print(f"bench_peers: our guide is timed alone: {error.name} is not installed", file=sys.stderr)
        return None
    torch.manual_seed(seed)
    return smp.Unet(f"tu-{encoder}", encoder_weights=None, classes=FEATURES).eval()


def _import_torchvision(torch: Any) -> None:
    """timm wants it. Its wheels for other devices lack operators, which these networks do without."""
    try:
        import torchvision
    except RuntimeError:
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        for name in ("nms", "qnms"):
            torch.library.define(f"torchvision::{name}", "(Tensor a, Tensor b, float c) -> Tensor")
        import torchvision  # noqa: F401


def torch_calls(network: Any, normalised: np.ndarray) -> dict[str, Callable[[], Any]]:
    """The network on one picture in both of torch's layouts."""
    import torch

    picture = torch.tensor(normalised).permute(2, 0, 1)[None].contiguous()
    last = copy.deepcopy(network).to(memory_format=torch.channels_last)
    picture_last = picture.to(memory_format=torch.channels_last)

    def call(network: Any, picture: Any) -> Any:
        with torch.inference_mode():
            return network(picture)

    return {TORCH: lambda: call(network, picture), CHANNELS_LAST: lambda: call(last, picture_last)}
