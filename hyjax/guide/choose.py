"""Guides by name: the frame itself, or a trained network. Flax is loaded only for those who train one."""

import dataclasses
import functools
from pathlib import Path
from typing import Protocol

import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.configuration import NO_GUIDE, GuideOptions
from hyjax.core.pyramid import downsample, upsample
from hyjax.util.errors import InputError, did_you_mean

SHIPPED = ("small",)
"""Networks whose weights come with the package."""
HALF = "-half"
"""Ending of the name of a shipped network at half the frame's size, see `ReducedGuide`."""


class FrameGuide(Protocol):
    """A function from frames to guides.

    Attributes:
        name: what tables call it.
        fingerprint: changes whenever its features may.
    """

    @property
    def name(self) -> str: ...

    @property
    def fingerprint(self) -> str: ...

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features of a display-encoded frame, in units in which the presets' κ are sensible."""
        ...


@dataclasses.dataclass(frozen=True)
class RgbGuide:
    """The frame itself, display-encoded: the "RGB guide"."""

    name: str = "rgb"
    fingerprint: str = "rgb"

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
        """The frame."""
        return display


RGB = RgbGuide()


@dataclasses.dataclass(frozen=True)
class ConstantGuide:
    """No guide: diffusion without edges."""

    name: str = NO_GUIDE
    fingerprint: str = NO_GUIDE

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w 1"]:
        """Zeros."""
        return jnp.zeros((*display.shape[:2], 1), display.dtype)


@dataclasses.dataclass(frozen=True)
class SizedGuide:
    """A guide of the frame at a size, bilinear in between.

    Attributes:
        guide: what computes the features.
        size: longer side, in pixels, that it sees, at least.
    """

    guide: FrameGuide
    size: int

    @property
    def name(self) -> str:
        """The guide's, with the size."""
        return f"{self.guide.name}-{self.size}"

    @property
    def fingerprint(self) -> str:
        """Changes with the guide's."""
        return f"{self.guide.fingerprint}-{self.size}"

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features of a frame, see `FrameGuide.features`."""
        factor = max(1, max(display.shape[:2]) // self.size)
        return _reduced(self.guide, display, factor)


@dataclasses.dataclass(frozen=True)
class ReducedGuide:
    """A guide of the frame at half its size, bilinear in between: a network in a quarter of the time.

    Attributes:
        guide: what computes the features.
    """

    guide: FrameGuide

    @property
    def name(self) -> str:
        """The guide's, with `HALF`."""
        return f"{self.guide.name}{HALF}"

    @property
    def fingerprint(self) -> str:
        """Changes with the guide's."""
        return f"{self.guide.fingerprint}{HALF}"

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features of a frame, see `FrameGuide.features`."""
        return _reduced(self.guide, display, 2)


def _reduced(guide: FrameGuide, display: Float[Array, "h w 3"], factor: int) -> Float[Array, "h w f"]:
    if factor == 1:
        return guide.features(display)
    return upsample(guide.features(downsample(display, factor)), factor, (display.shape[0], display.shape[1]))


def configured_guide(options: GuideOptions) -> FrameGuide:
    """Guide of a configuration.

    Raises:
        InputError: there is no such guide, or its file cannot be used.
    """
    guide = _opened(options.name)
    if options.size is None or options.name in (RGB.name, NO_GUIDE):
        return guide
    return SizedGuide(guide, options.size)


@functools.lru_cache(maxsize=4)
def _opened(name: str) -> FrameGuide:
    """Guide whose weights are read once."""
    return open_guide(name)


def open_guide(name: str = "rgb") -> FrameGuide:
    """A guide by name.

    Args:
        name: `rgb`, `none`, the name of shipped weights (`small`; `small-half` at half the frame's size), or a
            safetensors file that `hyjax train` wrote.

    Raises:
        InputError: there is no such guide, or its file cannot be used.
    """
    if name == RGB.name:
        return RGB
    if name == NO_GUIDE:
        return ConstantGuide()
    from hyjax.guide.inference import load_guide  # with flax, which the RGB guide does without

    shipped = name.removesuffix(HALF)
    if shipped in SHIPPED:
        guide = load_guide(Path(__file__).with_name("trained") / f"{shipped}.safetensors", shipped)
        return guide if shipped == name else ReducedGuide(guide)
    if not Path(name).is_file():
        known = (RGB.name, NO_GUIDE, *SHIPPED, *(name + HALF for name in SHIPPED))
        raise InputError(
            f"guide: {name}: no such file{did_you_mean(name, known)}; give a safetensors file, or one of "
            f"{', '.join(known)}"
        )
    return load_guide(Path(name))
