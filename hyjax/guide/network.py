"""Guide network: an encoder, the U-Net's decoder, and a last convolution."""

from collections.abc import Callable, Sequence
from typing import Protocol

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from hyjax.guide.convolution import Picture
from hyjax.guide.layers import XAVIER_UNIFORM, Conv
from hyjax.guide.mobilenetv4 import mobilenetv4_conv_medium, mobilenetv4_conv_small
from hyjax.guide.unet import DECODER_CHANNELS, UnetDecoder
from hyjax.util.errors import InputError, did_you_mean

MEAN = (0.485, 0.456, 0.406)
"""Mean of ImageNet's display-encoded pictures, with which encoders are trained."""
DEVIATION = (0.229, 0.224, 0.225)
"""Standard deviation of ImageNet's display-encoded pictures."""


class Encoder(Protocol):
    """Encoder of the U-Net, an `nnx.Module`.

    Attributes:
        channels: of its feature maps, fine to coarse; at most five.
    """

    @property
    def channels(self) -> Sequence[int]: ...

    def __call__(self, image: Float[Array, "b h w 3"]) -> Sequence[Picture]:
        """Feature maps, fine to coarse: the first ⌈H/2⌉ high, each other one half as high as the one before."""


ENCODERS: dict[str, Callable[..., Encoder]] = {
    "mobilenetv4_conv_small": mobilenetv4_conv_small,
    "mobilenetv4_conv_medium": mobilenetv4_conv_medium,
}
"""Encoders by name, each made by `ENCODERS[name](rngs=rngs)`: a file and a line here, or `register_encoder`."""


def register_encoder(name: str, make: Callable[..., Encoder]) -> None:
    """Add an encoder to `ENCODERS`.

    Args:
        name: in settings and in files with weights.
        make: called as `make(rngs=rngs)`.

    Raises:
        InputError: there is one of this name.
    """
    if name in ENCODERS:
        raise InputError(f"encoder: {name!r} is registered already; choose another name")
    ENCODERS[name] = make


class GuideNetwork(nnx.Module):
    """U-Net from pictures to guide features.

    Batch norms use the statistics of the batch after `.train()` and the running ones after `.eval()`.

    Args:
        encoder: name in `ENCODERS`.
        features: channels of the guide.
        rngs: of the initial weights.

    Raises:
        InputError: unknown encoder, one with too many maps, or no features.
    """

    def __init__(self, encoder: str = "mobilenetv4_conv_small", features: int = 64, *, rngs: nnx.Rngs) -> None:
        if encoder not in ENCODERS:
            known = f"{', '.join(ENCODERS)}{did_you_mean(encoder, ENCODERS)}"
            raise InputError(f"encoder: {encoder!r} is unknown; use one of {known}")
        if features < 1:
            raise InputError(f"features: need at least 1, got {features}")
        self.encoder_name = encoder
        self.features = features
        self.encoder = ENCODERS[encoder](rngs=rngs)
        channels = self.encoder.channels
        if not 1 <= len(channels) <= len(DECODER_CHANNELS):
            raise InputError(f"encoder: {encoder} has {len(channels)} maps; the decoder takes 1 to 5")
        self.decoder = UnetDecoder(channels, rngs=rngs)
        head = Conv(self.decoder.channels, features, bias=True, initial=XAVIER_UNIFORM, rngs=rngs)
        self.segmentation_head = nnx.List([head])

    def __call__(self, image: Float[Array, "b h w 3"]) -> Float[Array, "b h w features"]:
        """Guide features of normalised pictures (see `normalise`) of any size."""
        if image.ndim != 4 or image.shape[-1] != 3:
            raise InputError(f"image: need B x H x W x 3 RGB pictures, got shape {image.shape}")
        return self.segmentation_head[0](self.trunk(image))

    def trunk(self, image: Float[Array, "b h w 3"]) -> Float[Array, "b h w t"]:
        """Input of the last convolution."""
        return self.decoder(self.encoder(image), image.shape[1], image.shape[2])


def normalise(display: Float[Array, "*b h w 3"]) -> Float[Array, "*b h w 3"]:
    """Normalise display-encoded pictures in [0, 1] for encoders: ImageNet's mean 0 and deviation 1."""
    return (display - jnp.asarray(MEAN, display.dtype)) / jnp.asarray(DEVIATION, display.dtype)
