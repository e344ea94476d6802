"""Decoder of a U-Net as built by the library segmentation_models_pytorch.

Source: Ronneberger et al., *U-Net: Convolutional Networks for Biomedical Image Segmentation*, MICCAI 2015; the
nearest-neighbour upsampling and the numbers of convolutions and channels per level are that library's.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from flax import nnx

from hyjax.guide.convolution import Picture, convolve, convolve_upsampled, parity_kernels, upsample
from hyjax.guide.layers import KAIMING_UNIFORM, ConvNorm

DECODER_CHANNELS = (256, 128, 64, 32, 16)
"""Channels after each doubling up to full size; the last ones, if an encoder halves less often."""
LEAST_PARITY_PIXELS = 32 * 32
"""Number of pixels from which `convolve_upsampled` saves more than adding up its kernels costs, unless folded."""


class DecoderBlock(nnx.Module):
    """Decoder block: doubles the size, joins the encoder's map of that size, and convolves twice.

    Attributes:
        conv1: first convolution, of both together.
        conv2: second convolution.
        parities: once folded, `parity_kernels` of the first one's part for the doubled map.
    """

    def __init__(self, inputs: int, skipped: int, outputs: int, *, rngs: nnx.Rngs) -> None:
        def layer(name: str, before: int) -> ConvNorm:
            names = f"{name}.0", f"{name}.1"
            return ConvNorm(before, outputs, names=names, initial=KAIMING_UNIFORM, rngs=rngs)

        self.conv1 = layer("conv1", inputs + skipped)
        self.conv2 = layer("conv2", outputs)
        self.parities: nnx.List = nnx.List()
        self.inputs = inputs

    def fold(self) -> None:
        """Add up the kernels for every parity once, after the batch norms were folded."""
        kernel = self.conv1.conv.kernel[...][:, :, : self.inputs]
        self.parities = nnx.List([nnx.Param(parity) for parity in parity_kernels(kernel)])

    def __call__(self, x: Picture, skip: Picture | None, height: int, width: int) -> Picture:
        doubled = (height, width) == (2 * x.shape[1], 2 * x.shape[2])
        if doubled and (self.parities or x.shape[1] * x.shape[2] >= LEAST_PARITY_PIXELS):
            return self.conv2(self._convolve_parities(x, skip))
        x = upsample(x, height, width)
        return self.conv2(self.conv1(x if skip is None else jnp.concatenate([x, skip], -1)))

    def _convolve_parities(self, x: Picture, skip: Picture | None) -> Picture:
        conv = self.conv1.conv
        kernel = conv.kernel[...]
        folded = [parity[...] for parity in self.parities]
        y = convolve_upsampled(x, folded or parity_kernels(kernel[:, :, : self.inputs]))
        if skip is not None:
            y = y + convolve(skip, kernel[:, :, self.inputs :])
        return self.conv1.activate(conv.add_bias(y))


class UnetDecoder(nnx.Module):
    """Decoder from the feature maps of an encoder to one map of the picture's size.

    Attributes:
        channels: of that map.
    """

    def __init__(self, encoder_channels: Sequence[int], *, rngs: nnx.Rngs) -> None:
        outputs = DECODER_CHANNELS[-len(encoder_channels) :]
        inputs = (encoder_channels[-1], *outputs[:-1])
        skipped = (*reversed(encoder_channels[:-1]), 0)
        self.blocks = nnx.List([DecoderBlock(*sizes, rngs=rngs) for sizes in zip(inputs, skipped, outputs)])
        self.channels = outputs[-1]

    def __call__(self, maps: Sequence[Picture], height: int, width: int) -> Picture:
        return self.levels(maps, height, width)[-1]

    def levels(self, maps: Sequence[Picture], height: int, width: int) -> list[Picture]:
        """Output of each block, coarse to fine."""
        *skips, x = maps
        sizes = [(height, width), *((skip.shape[1], skip.shape[2]) for skip in skips)]
        levels = []
        for block, size, skip in zip(self.blocks, reversed(sizes), [*reversed(skips), None]):
            levels.append(x := block(x, skip, *size))
        return levels
