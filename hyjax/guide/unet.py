"""The decoder of a U-Net as the library segmentation_models_pytorch builds it.

Source: Ronneberger et al., *U-Net: Convolutional Networks for Biomedical Image Segmentation*, MICCAI 2015; that the
nearest neighbour upsamples and how many convolutions and channels a level has is that library's.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from flax import nnx

from hyjax.guide.convolution import Picture, upsample
from hyjax.guide.layers import KAIMING_UNIFORM, ConvNorm

DECODER_CHANNELS = (256, 128, 64, 32, 16)
"""After each doubling of the size, down to full size; the last ones, if an encoder halves less often."""


class DecoderBlock(nnx.Module):
    """Doubles the size, joins the encoder's map of that size, and convolves twice."""

    def __init__(self, inputs: int, skipped: int, outputs: int, *, rngs: nnx.Rngs) -> None:
        def layer(name: str, before: int) -> ConvNorm:
            names = f"{name}.0", f"{name}.1"
            return ConvNorm(before, outputs, names=names, initial=KAIMING_UNIFORM, rngs=rngs)

        self.conv1 = layer("conv1", inputs + skipped)
        self.conv2 = layer("conv2", outputs)

    def __call__(self, x: Picture, skip: Picture | None, height: int, width: int) -> Picture:
        x = upsample(x, height, width)
        return self.conv2(self.conv1(x if skip is None else jnp.concatenate([x, skip], -1)))


class UnetDecoder(nnx.Module):
    """Feature maps of an encoder become one map of the picture's size.

    Attributes:
        channels: of that map.
    """

    def __init__(self, encoder_channels: Sequence[int], *, rngs: nnx.Rngs) -> None:
        outputs = DECODER_CHANNELS[-len(encoder_channels) :]
        inputs = (encoder_channels[-1], *outputs[:-1])
        skipped = (*reversed(encoder_channels[:-1]), 0)
        self.blocks = nnx.List([DecoderBlock(*each, rngs=rngs) for each in zip(inputs, skipped, outputs)])
        self.channels = outputs[-1]

    def __call__(self, maps: Sequence[Picture], height: int, width: int) -> Picture:
        *skips, x = maps
        sizes = [(height, width), *((skip.shape[1], skip.shape[2]) for skip in skips)]
        for block, size, skip in zip(self.blocks, reversed(sizes), [*reversed(skips), None]):
            x = block(x, skip, *size)
        return x
