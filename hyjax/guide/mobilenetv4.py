"""Convolutional MobileNetV4 encoders as defined by the library timm.

Source: Qin et al., *MobileNetV4: Universal Models for the Mobile Ecosystem*, ECCV 2024, arXiv:2404.10518; the
tables below are its networks without the classifier.
"""

import dataclasses

from flax import nnx

from hyjax.guide.convolution import Picture
from hyjax.guide.layers import ConvNorm

STEM_CHANNELS = 32
"""Number of channels after the first convolution."""


@dataclasses.dataclass(frozen=True)
class PlainConv:
    """Specification of a convolution with batch norm and rectifier."""

    channels: int
    width: int
    stride: int = 1


@dataclasses.dataclass(frozen=True)
class Fused:
    """Specification of a fused inverted bottleneck: a wide expanding convolution, then a 1×1 projection."""

    channels: int
    width: int
    expansion: int
    stride: int = 1


@dataclasses.dataclass(frozen=True)
class Universal:
    """Specification of a universal inverted bottleneck: 1×1 expansion and projection, depthwise before and between.

    A width of 0 leaves that convolution out: the paper's ExtraDW has both, IR the second, ConvNeXt the first, FFN
    neither.
    """

    channels: int
    start: int
    middle: int
    expansion: int
    stride: int = 1


Block = PlainConv | Fused | Universal
Stages = tuple[tuple[Block, ...], ...]

LAST_STAGE: tuple[Block, ...] = (PlainConv(960, 1),)

SMALL_STAGES: Stages = (
    (PlainConv(32, 3, stride=2), PlainConv(32, 1)),
    (PlainConv(96, 3, stride=2), PlainConv(64, 1)),
    (Universal(96, 5, 5, 3, stride=2), *4 * (Universal(96, 0, 3, 2),), Universal(96, 3, 0, 4)),
    (
        Universal(128, 3, 3, 6, stride=2),
        Universal(128, 5, 5, 4),
        Universal(128, 0, 5, 4),
        Universal(128, 0, 5, 3),
        *2 * (Universal(128, 0, 3, 4),),
    ),
    LAST_STAGE,
)

MEDIUM_STAGES: Stages = (
    (Fused(48, 3, 4, stride=2),),
    (Universal(80, 3, 5, 4, stride=2), Universal(80, 3, 3, 2)),
    (
        Universal(160, 3, 5, 6, stride=2),
        *2 * (Universal(160, 3, 3, 4),),
        Universal(160, 3, 5, 4),
        Universal(160, 3, 3, 4),
        Universal(160, 3, 0, 4),
        Universal(160, 0, 0, 2),
        Universal(160, 3, 0, 4),
    ),
    (
        Universal(256, 5, 5, 6, stride=2),
        Universal(256, 5, 5, 4),
        *2 * (Universal(256, 3, 5, 4),),
        Universal(256, 0, 0, 4),
        Universal(256, 3, 0, 4),
        Universal(256, 3, 5, 2),
        Universal(256, 5, 5, 4),
        *2 * (Universal(256, 0, 0, 4),),
        Universal(256, 5, 0, 2),
    ),
    LAST_STAGE,
)


class ConvBlock(nnx.Module):
    """Layers of a `PlainConv`."""

    def __init__(self, inputs: int, block: PlainConv, *, rngs: nnx.Rngs) -> None:
        self.conv = ConvNorm(inputs, block.channels, block.width, block.stride, names=("conv", "bn1"), rngs=rngs)

    def __call__(self, x: Picture) -> Picture:
        return self.conv(x)


class FusedBlock(nnx.Module):
    """Layers of a `Fused` bottleneck."""

    def __init__(self, inputs: int, block: Fused, *, rngs: nnx.Rngs) -> None:
        wide = inputs * block.expansion
        self.expand = ConvNorm(inputs, wide, block.width, block.stride, names=("conv_exp", "bn1"), rngs=rngs)
        self.project = ConvNorm(wide, block.channels, 1, names=("conv_pwl", "bn2"), relu=False, rngs=rngs)
        self.residual = inputs == block.channels and block.stride == 1

    def __call__(self, x: Picture) -> Picture:
        y = self.project(self.expand(x))
        return x + y if self.residual else y


class UniversalBlock(nnx.Module):
    """Layers of a `Universal` bottleneck."""

    def __init__(self, inputs: int, block: Universal, *, rngs: nnx.Rngs) -> None:
        wide, outputs = inputs * block.expansion, block.channels

        def layer(name: str, before: int, after: int, width: int, stride: int = 1, relu: bool = True) -> ConvNorm:
            names = f"{name}.conv", f"{name}.bn"
            return ConvNorm(before, after, width, stride, names=names, depthwise=width > 1, relu=relu, rngs=rngs)

        self.start = layer("dw_start", inputs, inputs, block.start, relu=False) if block.start else None
        self.expand = layer("pw_exp", inputs, wide, 1)
        self.middle = layer("dw_mid", wide, wide, block.middle, block.stride) if block.middle else None
        self.project = layer("pw_proj", wide, outputs, 1, relu=False)
        self.residual = inputs == outputs and block.stride == 1

    def __call__(self, x: Picture) -> Picture:
        y = self.expand(self.start(x) if self.start else x)
        y = self.project(self.middle(y) if self.middle else y)
        return x + y if self.residual else y


BLOCKS = {PlainConv: ConvBlock, Fused: FusedBlock, Universal: UniversalBlock}


class MobileNetV4(nnx.Module):
    """Encoder of a picture to five feature maps, each half as wide and high as the one before.

    Attributes:
        channels: of each map, fine to coarse.
    """

    def __init__(self, stages: Stages, *, rngs: nnx.Rngs) -> None:
        self.stem = ConvNorm(3, STEM_CHANNELS, 3, 2, names=("conv_stem", "bn1"), rngs=rngs)
        self.blocks: nnx.List[nnx.List] = nnx.List()
        before = STEM_CHANNELS
        for stage in stages:
            blocks: nnx.List[nnx.Module] = nnx.List()
            for block in stage:
                blocks.append(BLOCKS[type(block)](before, block, rngs=rngs))
                before = block.channels
            self.blocks.append(blocks)
        # The maps are those at the end of each resolution.
        self.channels = (STEM_CHANNELS, *(stage[-1].channels for stage in stages[:3]), stages[-1][-1].channels)

    def __call__(self, image: Picture) -> list[Picture]:
        x = self.stem(image)
        maps = [x]
        for stage in self.blocks:
            for block in stage:
                x = block(x)
            maps.append(x)
        return [*maps[:4], maps[-1]]


def mobilenetv4_conv_small(*, rngs: nnx.Rngs) -> MobileNetV4:
    """MobileNetV4-Conv-S without its classifier; 1.26 M parameters."""
    return MobileNetV4(SMALL_STAGES, rngs=rngs)


def mobilenetv4_conv_medium(*, rngs: nnx.Rngs) -> MobileNetV4:
    """MobileNetV4-Conv-M without its classifier; 7.20 M parameters."""
    return MobileNetV4(MEDIUM_STAGES, rngs=rngs)
