"""Frames in memory as a capture."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture, Frame
from hyjax.geometry.depth_sensor import UNKNOWN, DepthSensor


class ListedFrames(Capture):
    """A capture of some frames."""

    name, fingerprint = "listed", "listed"

    def __init__(self, frames: Sequence[Frame], up: Float[np.ndarray, "3"], sensor: DepthSensor = UNKNOWN) -> None:
        self.frames, self.up, self.sensor = frames, up, sensor

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Frame:
        return self.frames[index]
