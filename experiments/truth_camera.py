"""Pictures as a camera takes them, for `experiments.truth`: its response and its exposure.

A relit picture may miss the truth by exposure and white balance alone. What is left beside them is told by fitting
three gains in linear light, before the response, to the least squared error of display values.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.room.render import CONTRAST
from hyjax.synthetic.tone_curve import encode, tone

Image = Float[np.ndarray, "h w 3"]
Response = Callable[[np.ndarray], np.ndarray]
BRIGHTEST = 2.5
"""Exposed light that the camera shows as white."""
LARGEST_GAIN = 12.0
STRIDE = 4
"""Every so-manieth pixel of each row and column is enough to fit a gain."""
GRIDS = ((25, 1.0), (13, 1 / 12), (13, 1 / 72))
"""Gains tried and the share of the logarithmic range that they span, again and again round the best."""


@dataclasses.dataclass(frozen=True)
class Exposed:
    """A picture before the camera's response.

    Attributes:
        linear: light.
        response: from light to display values, one channel like the other.
    """

    linear: Image
    response: Response = encode

    def display(self, gains: Float[np.ndarray, "3"] | float = 1.0) -> Image:
        """Display values with another exposure."""
        return self.response(self.linear * gains).astype(np.float32)


def camera_response(linear: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Exposed and balanced light → display values, as the generated rooms' camera has it."""
    display = encode(tone(np.maximum(linear, 0)))
    return display + CONTRAST * (display * display * (3 - 2 * display) - display)


def exposed_light(display: Image) -> Image:
    """Light that the generated rooms' camera shows as these display values, white balance left in."""
    light = np.linspace(0.0, BRIGHTEST ** (1 / 3), 4096) ** 3  # finer in the dark
    return np.interp(display, camera_response(light), light).astype(np.float32)


def fit_gains(picture: Exposed, truth: Image) -> Float[np.ndarray, "3"]:
    """Gain of each channel that brings a picture nearest to the truth, within `LARGEST_GAIN` either way."""
    light, target = (x[::STRIDE, ::STRIDE].reshape(-1, 3) for x in (picture.linear, truth))
    reach, best = np.log(LARGEST_GAIN), np.zeros(3)
    for count, share in GRIDS:
        tried = np.clip(best + share * reach * np.linspace(-1, 1, count)[:, None], -reach, reach)
        shown = picture.response(np.exp(tried)[:, None].astype(np.float32) * light)
        error = np.mean((shown - target) ** 2, axis=1)
        best = np.take_along_axis(tried, error.argmin(axis=0)[None], axis=0)[0]
    return np.exp(best)
