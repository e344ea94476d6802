"""Guides by name: the frame itself, or a trained network. Flax is loaded for training only."""

import dataclasses
import functools
from pathlib import Path
from typing import Protocol

import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.configuration import GuideOptions
from hyjax.core.pyramid import downsample, upsample
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, did_you_mean

NO_GUIDE = "none"
"""Name of a guide without edges."""
SHIPPED_NAMES = ("small",)
"""Names of the networks whose weights come with the package."""
HALF_SUFFIX = "-half"
"""Suffix of the name of a shipped network at half the frame's size, see `ReducedGuide`."""


class FrameGuide(Protocol):
    """Function from frames to guides.

    Attributes:
        name: its name in tables.
        fingerprint: hash that changes whenever its features may.
    """

    @property
    def name(self) -> str: ...

    @property
    def fingerprint(self) -> str: ...

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features of a display-encoded frame, in units that suit the presets' κ."""
        ...


@dataclasses.dataclass(frozen=True)
class RgbGuide:
    """RGB guide: the frame itself, display-encoded."""

    name: str = "rgb"
    fingerprint: str = "rgb"

    @checked_arguments
    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
        """Features of a frame: the frame itself."""
        return display


RGB = RgbGuide()


@dataclasses.dataclass(frozen=True)
class ConstantGuide:
    """Constant guide: diffusion without edges."""

    name: str = NO_GUIDE
    fingerprint: str = NO_GUIDE

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w 1"]:
        """Features of a frame: zeros."""
        return jnp.zeros((*display.shape[:2], 1), display.dtype)


@dataclasses.dataclass(frozen=True)
class ReducedGuide:
    """Guide of a smaller frame, interpolated bilinearly: at half the size a network takes a quarter of the time.

    Attributes:
        guide: that computes the features.
        size: least longer side of its frames, in pixels; None for half the frame's size.
    """

    guide: FrameGuide
    size: int | None = None

    @property
    def name(self) -> str:
        """Name of the guide, with the size or `HALF_SUFFIX`."""
        return f"{self.guide.name}{self._suffix}"

    @property
    def fingerprint(self) -> str:
        """Changes with the guide's."""
        return f"{self.guide.fingerprint}{self._suffix}"

    @property
    def _suffix(self) -> str:
        return HALF_SUFFIX if self.size is None else f"-{self.size}"

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features of a frame, see `FrameGuide.features`."""
        factor = 2 if self.size is None else max(1, max(display.shape[:2]) // self.size)
        if factor == 1:
            return self.guide.features(display)
        small = self.guide.features(downsample(display, factor))
        return upsample(small, factor, (display.shape[0], display.shape[1]))


@checked_arguments
def configured_guide(options: GuideOptions) -> FrameGuide:
    """Guide of a configuration."""
    guide = _opened(options.name, _version(options.name))
    if options.size is None or options.name in (RGB.name, NO_GUIDE):
        return guide
    return ReducedGuide(guide, options.size)


@functools.lru_cache(maxsize=4)
def _opened(name: str, version: tuple[int, ...]) -> FrameGuide:
    """Open guide, with the weights of a version of its file read once."""
    return open_guide(name)


def _version(name: str) -> tuple[int, ...]:
    """Version of a guide's file, which training may write again; empty for one without a file."""
    try:
        state = Path(name).stat()
    except OSError:
        return ()
    return state.st_mtime_ns, state.st_size, state.st_ino


@checked_arguments
def open_guide(name: str = "rgb") -> FrameGuide:
    """Open a guide by name.

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

    shipped = name.removesuffix(HALF_SUFFIX)
    if shipped in SHIPPED_NAMES:
        guide = load_guide(Path(__file__).with_name("trained") / f"{shipped}.safetensors", shipped)
        return guide if shipped == name else ReducedGuide(guide)
    if not Path(name).is_file():
        known = (RGB.name, NO_GUIDE, *SHIPPED_NAMES, *(name + HALF_SUFFIX for name in SHIPPED_NAMES))
        raise InputError(
            f"guide: {name}: no such file{did_you_mean(name, known)}; give a safetensors file, or one of "
            f"{', '.join(known)}"
        )
    return load_guide(Path(name))
