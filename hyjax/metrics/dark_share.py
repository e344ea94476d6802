"""Shares of pictures that end nearly black or burnt out, and which of them a relighting has darkened too far."""

import dataclasses

import numpy as np
from jaxtyping import Float

BLACK_VALUE, BURNT_VALUE = 0.1, 0.97
"""Display values, means of the channels, below which a pixel is nearly black, and from which it is burnt out."""
MOST_BLACK, MOST_BLACK_BEFORE = 0.3, 0.1
"""Share of nearly black pixels from which a relit picture is too dark, where the photo has less than the second."""
MOST_BLACK_ANEW = 0.5
"""Share of the pixels that were not nearly black from which a relit picture that made them so is too dark, too."""
MOST_BURNT_ANEW, MOST_CLIPPED_ANEW = 0.1, 0.5
"""Shares of pixels that burnt out anew, and of those of which a channel did, from which a picture is too bright."""
STRIDE = 2
"""Step of the sampled pixels along rows and columns."""


@dataclasses.dataclass(frozen=True)
class DarkShare:
    """Shares of a picture's pixels, before and after it was relit.

    Attributes:
        black_before, black: nearly black pixels of the photo, and of the relit picture.
        burnt_before, burnt: burnt-out ones.
        clipped_before, clipped: those of which one channel is burnt out.
    """

    black_before: float
    black: float
    burnt_before: float
    burnt: float
    clipped_before: float = 0.0
    clipped: float = 0.0

    @property
    def too_dark(self) -> bool:
        """Whether a good part of the picture went black that was not."""
        anew = (self.black - self.black_before) / max(1.0 - self.black_before, 1e-9)
        return (self.black > MOST_BLACK and self.black_before < MOST_BLACK_BEFORE) or anew > MOST_BLACK_ANEW

    @property
    def too_bright(self) -> bool:
        """Whether a good part of the picture burnt out that was not."""
        clipped = self.clipped - self.clipped_before
        return self.burnt - self.burnt_before > MOST_BURNT_ANEW or clipped > MOST_CLIPPED_ANEW


def dark_share(photo: Float[np.ndarray, "h w 3"], relit: Float[np.ndarray, "h w 3"]) -> DarkShare:
    """Shares of nearly black and burnt-out pixels of a photo and of its relit picture.

    >>> photo, relit = np.full((4, 4, 3), 0.5), np.zeros((4, 4, 3))
    >>> dark_share(photo, relit).black, dark_share(photo, relit).too_dark
    (1.0, True)

    Args:
        photo, relit: display values.
    """
    black, burnt, clipped = zip(*map(_shares, (photo, relit)))
    return DarkShare(*black, *burnt, *clipped)


def _shares(picture: Float[np.ndarray, "h w 3"]) -> tuple[float, float, float]:
    """Shares of nearly black and burnt-out pixels, and of those with a burnt-out channel."""
    # By channels: NumPy takes ten times longer along an axis of three.
    red, green, blue = np.ascontiguousarray(np.moveaxis(np.asarray(picture)[::STRIDE, ::STRIDE], -1, 0))
    mean, largest = (red + green + blue) / 3, np.maximum(np.maximum(red, green), blue)
    black, burnt, clipped = (
        mask.mean() for mask in (mean < BLACK_VALUE, mean >= BURNT_VALUE, largest >= BURNT_VALUE)
    )
    return float(black), float(burnt), float(clipped)
