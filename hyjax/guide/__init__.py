"""Guide features from pictures: MobileNetV4 encoders in a U-Net, with weights in and out."""

from hyjax.guide.network import ENCODERS, Encoder, GuideNetwork, normalise

__all__ = ["ENCODERS", "Encoder", "GuideNetwork", "normalise"]
