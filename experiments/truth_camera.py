"""Pictures as a camera takes them, for `experiments.truth`: its response and its exposure.

A relit picture may miss the truth by exposure and white balance alone. What is left beside them is told by fitting
three gains in linear light, before the response, to the least squared error of display values.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.metrics import exposure
from hyjax.metrics.exposure import Response
from hyjax.synthetic.room.render import CONTRAST
from hyjax.synthetic.tone_curve import encode, tone

Image = Float[np.ndarray, "h w 3"]
WHITE_LIGHT = 2.5
"""Exposed light that the camera shows as white."""


@dataclasses.dataclass(frozen=True)
class Exposed:
    """A picture before the camera's response.

    Attributes:
        linear: light.
        response: from light to display values, one channel like the other.
    """

    linear: Image
    response: Response = exposure.displayed

    def display(self, gains: Float[np.ndarray, "3"] | float = 1.0) -> Image:
        """Display values with another exposure."""
        return self.response(self.linear * gains).astype(np.float32)


def camera_response(linear: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Exposed and balanced light → display values, as the generated rooms' camera has it."""
    display = encode(tone(np.maximum(linear, 0)))
    return display + CONTRAST * (display * display * (3 - 2 * display) - display)


def exposed_light(display: Image) -> Image:
    """Light that the generated rooms' camera shows as these display values, white balance left in."""
    light = np.linspace(0.0, WHITE_LIGHT ** (1 / 3), 4096) ** 3  # finer in the dark
    return np.interp(display, camera_response(light), light).astype(np.float32)


def fit_gains(picture: Exposed, truth: Image) -> Float[np.ndarray, "3"]:
    """Gain of each channel that brings a picture nearest to the truth, see `hyjax.metrics.exposure`."""
    return exposure.fit_gains(picture.linear, truth, picture.response)
