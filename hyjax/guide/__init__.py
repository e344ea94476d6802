"""Guide features from pictures: MobileNetV4 encoders in a U-Net, with files of weights."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hyjax.guide.inference import Guide, load_guide
    from hyjax.guide.network import ENCODERS, Encoder, GuideNetwork, normalise, register_encoder
    from hyjax.guide.weights import load_network, load_weights, save_guide

__all__ = [
    "ENCODERS",
    "Encoder",
    "Guide",
    "GuideNetwork",
    "load_guide",
    "load_network",
    "load_weights",
    "normalise",
    "register_encoder",
    "save_guide",
]

MODULE_NAMES = {
    "network": ("ENCODERS", "Encoder", "GuideNetwork", "normalise", "register_encoder"),
    "weights": ("load_network", "load_weights", "save_guide"),
    "inference": ("Guide", "load_guide"),
}


def __getattr__(name: str) -> Any:
    """Load the names above, and flax with them, on first use; `hyjax.guide.choose` needs no flax."""
    for module, names in MODULE_NAMES.items():
        if name in names:
            return getattr(importlib.import_module(f"hyjax.guide.{module}"), name)
    raise AttributeError(f"module 'hyjax.guide' has no attribute {name!r}")
