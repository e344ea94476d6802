"""Pictures that frames should look like, where they are known, and scores against them."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.frames import fit
from hyjax.data.truth_room import TruthCapture
from hyjax.light.setup import LightSetup
from hyjax.metrics import METRICS
from hyjax.scene.scene import Scene
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.scene import Target
from hyjax.util.errors import InputError, shown

Picture = Float[np.ndarray, "h w 3"]
Truth = Callable[[int, LightSetup], Picture | None]
"""Function from a frame's position and lights to the picture that it should be, display values; None if unknown."""
LABELS = {"loss": "loss", "psnr_raw": "PSNR dB as it is"}
"""Headings of scores that are no metric of the registry."""


class KnownTruth:
    """What the frames of a scene should look like, as far as that is known.

    Of a generated room it is known under named lights: their light is baked, which takes seconds, once.
    """

    def __init__(self, scene: Scene, own: Truth | None = None) -> None:
        self._scene, self._own = scene, own
        self.known = own is not None or isinstance(scene.capture, TruthCapture)

    def picture(
        self, index: int, lights: LightSetup | str, setup: LightSetup, shape: tuple[int, ...]
    ) -> Picture | None:
        """True picture of a frame, display values; None where it is not known.

        Args:
            lights: as they were given.
            setup: the same, placed.
        """
        capture = self._scene.capture
        if not self.known:
            return None
        if self._own is not None:
            told = self._own(index, setup)
        elif isinstance(lights, str) and isinstance(capture, TruthCapture):
            (told,) = capture.truth(setup, [index])
            told = fit(dataclasses.replace(capture.picture(index), image=told), self._scene.size).image
        else:
            return None
        if told is not None and np.shape(told) != shape:
            raise InputError(f"truth: must be a picture of {shown(shape)}, got {shown(np.shape(told))}")
        return None if told is None else np.asarray(told, np.float32)


def scores(pictures: Mapping[str, Any], truth: Picture) -> list[dict[str, Any]]:
    """Loss and metrics of relit pictures, linear, by their names: a row for each.

    The loss is that of tuning; it and the metrics are of pictures whose exposure and white balance are fitted.
    """
    target = Target(truth, np.ones(truth.shape[:2], bool), True)
    return [{"name": name} | PictureLoss().scores(np.asarray(image), target) for name, image in pictures.items()]


def lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The rows in words."""
    digits = {"loss": 5, "psnr_raw": 2} | {name: metric.digits for name, metric in METRICS.items()}
    labels = LABELS | {name: metric.label for name, metric in METRICS.items()}
    found = []
    for row in rows:
        values = [f"{labels[key]} {value:.{digits[key]}f}" for key, value in row.items() if key != "name"]
        found.append(f"{row['name']}: {', '.join(values)}")
    return found
