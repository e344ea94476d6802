"""Guides of a smaller picture: a learned guide in a quarter of the time, with coarser borders."""

import dataclasses

from jaxtyping import Array, Float

from hyjax.core.pyramid import downsample, upsample
from hyjax.guide.choose import FrameGuide
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class ReducedGuide:
    """Features of the frame at a fraction of its size, bilinear in between.

    Attributes:
        guide: what computes them.
        factor: how many times smaller.
    """

    guide: FrameGuide
    factor: int = 2

    def __post_init__(self) -> None:
        if self.factor < 2:
            raise InputError(f"guide: a reduced one must be at least 2 times smaller, got {self.factor}")

    @property
    def name(self) -> str:
        """Of the guide, with its size."""
        return f"{self.guide.name}, 1/{self.factor} size"

    @property
    def fingerprint(self) -> str:
        """Changes with the guide and the factor."""
        return f"{self.guide.fingerprint}/{self.factor}"

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Guide features of a frame; see `FrameGuide.features`."""
        small = self.guide.features(downsample(display, self.factor))
        return upsample(small, self.factor, (display.shape[0], display.shape[1]))
