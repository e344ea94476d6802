"""Guides by name: the frame itself, or a trained network. Flax is loaded only for those who train one."""

import dataclasses
from pathlib import Path
from typing import Protocol

from jaxtyping import Array, Float

from hyjax.util.errors import InputError, did_you_mean

SHIPPED = ("small",)
"""Networks whose weights come with the package."""


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


def open_guide(name: str = "rgb") -> FrameGuide:
    """A guide by name.

    Args:
        name: `rgb`, the name of shipped weights (`small`), or a safetensors file that `hyjax train` wrote.

    Raises:
        InputError: there is no such guide, or its file cannot be used.
    """
    if name == RGB.name:
        return RGB
    from hyjax.guide.inference import load_guide  # with flax, which the RGB guide does without

    if name in SHIPPED:
        return load_guide(Path(__file__).with_name("trained") / f"{name}.safetensors", name)
    if not Path(name).is_file():
        known = (RGB.name, *SHIPPED)
        raise InputError(
            f"guide: {name}: no such file{did_you_mean(name, known)}; give a safetensors file, or one of "
            f"{', '.join(known)}"
        )
    return load_guide(Path(name))
