"""Gains that match a picture's exposure and white balance to another's before a comparison."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from hyjax.light.color import encoded, held

Response = Callable[[np.ndarray], np.ndarray]
LARGEST_GAIN = 12.0
"""Largest gain, and inverse of the least one."""
STRIDE = 4
"""Step of the sampled pixels along rows and columns."""
GRIDS = ((25, 1.0), (13, 1 / 12), (13, 1 / 72))
"""Search grids: number of gains and their share of the logarithmic range, each around the last optimum."""


def displayed(linear: np.ndarray) -> np.ndarray:
    """Display values of light, see `hyjax.light.color.to_display`.

    >>> [round(float(value), 3) for value in displayed(np.array([0.0, 0.18, 2.0]))]
    [0.0, 0.461, 1.0]
    """
    return encoded(held(np.asarray(linear)))


def fit_gains(
    linear: Float[np.ndarray, "h w 3"],
    reference: Float[np.ndarray, "h w 3"],
    response: Response = displayed,
    *,
    valid: Bool[np.ndarray, "h w"] | None = None,
) -> Float[np.ndarray, "3"]:
    """Gain of each channel, in linear light, of least squared error of display values.

    >>> light = np.linspace(0.1, 0.4, 16 * 16 * 3).reshape(16, 16, 3)
    >>> [round(float(gain), 1) for gain in fit_gains(light, np.sqrt(2 * light), np.sqrt)]
    [2.0, 2.0, 2.0]

    Args:
        linear: the picture, in linear light.
        reference: display values.
        response: from light to display values, one channel like the other.
        valid: where the reference is valid; everywhere by default.

    Returns:
        Gains within a factor of `LARGEST_GAIN` either way.
    """
    light, target = (x[::STRIDE, ::STRIDE].reshape(-1, 3) for x in (linear, reference))
    if valid is not None:
        known = valid[::STRIDE, ::STRIDE].reshape(-1)
        if not known.any():
            return np.ones(3)
        light, target = light[known], target[known]
    reach, best = np.log(LARGEST_GAIN), np.zeros(3)
    for count, share in GRIDS:
        tried = np.clip(best + share * reach * np.linspace(-1, 1, count)[:, None], -reach, reach)
        shown = response(np.exp(tried)[:, None].astype(np.float32) * light)
        error = np.mean((shown - target) ** 2, axis=1)
        best = np.take_along_axis(tried, error.argmin(axis=0)[None], axis=0)[0]
    return np.exp(best)
