"""Shares of pictures that end nearly black or burnt out, and which of them a relighting has darkened too far."""

import dataclasses

import numpy as np
from jaxtyping import Float

BLACK_VALUE, BURNT_VALUE = 0.1, 0.97
"""Display values, means of the channels, below which a pixel is nearly black, and from which it is burnt out."""
MOST_BLACK, MOST_BLACK_BEFORE = 0.3, 0.1
"""Share of nearly black pixels from which a relit picture is too dark, where the photo has less than the second."""
MOST_BURNT_ANEW = 0.1
"""Share of burnt-out pixels, over that of the photo, from which a relit picture is too bright."""
STRIDE = 2
"""Step of the sampled pixels along rows and columns."""


@dataclasses.dataclass(frozen=True)
class DarkShare:
    """Shares of a picture's pixels, before and after it was relit.

    Attributes:
        black_before, black: nearly black pixels of the photo, and of the relit picture.
        burnt_before, burnt: burnt-out ones.
    """

    black_before: float
    black: float
    burnt_before: float
    burnt: float

    @property
    def too_dark(self) -> bool:
        """Whether a good part of the picture went black that was not."""
        return self.black > MOST_BLACK and self.black_before < MOST_BLACK_BEFORE

    @property
    def too_bright(self) -> bool:
        """Whether a good part of the picture burnt out that was not."""
        return self.burnt - self.burnt_before > MOST_BURNT_ANEW


def dark_share(photo: Float[np.ndarray, "h w 3"], relit: Float[np.ndarray, "h w 3"]) -> DarkShare:
    """Shares of nearly black and burnt-out pixels of a photo and of its relit picture.

    >>> photo, relit = np.full((4, 4, 3), 0.5), np.zeros((4, 4, 3))
    >>> dark_share(photo, relit).black, dark_share(photo, relit).too_dark
    (1.0, True)

    Args:
        photo, relit: display values.
    """
    before, after = (np.asarray(x)[::STRIDE, ::STRIDE].mean(axis=-1) for x in (photo, relit))
    shares = [float((own < BLACK_VALUE).mean()) for own in (before, after)]
    burnt = [float((own >= BURNT_VALUE).mean()) for own in (before, after)]
    return DarkShare(*shares, *burnt)
