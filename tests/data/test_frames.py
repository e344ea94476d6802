"""Frames brought to a size."""

import numpy as np
import pytest

from hyjax.data.capture import Frame
from hyjax.data.frames import shrink
from hyjax.geometry.camera import Camera, Intrinsics


@pytest.mark.parametrize(
    ("size", "longest", "expected"),
    [
        ((60, 80), 40, (30, 40)),
        ((80, 60), 40, (40, 30)),
        ((60, 80), 80, (60, 80)),
        ((60, 80), 200, (60, 80)),
        ((2, 200), 40, (1, 40)),
    ],
)
def test_a_frame_shrinks_to_its_longer_side_and_never_grows(
    size: tuple[int, int], longest: int, expected: tuple[int, int]
) -> None:
    height, width = size
    lens = Intrinsics(width, height, 50.0, 50.0, width / 2, height / 2)
    frame = Frame("f", np.full((*size, 3), 0.5, np.float32), Camera(lens, np.eye(4)), 0.0)
    small = shrink(frame, longest)
    assert small.image.shape == (*expected, 3) and small.camera.intrinsics.shape == expected
    if expected == size:
        assert small.camera.intrinsics == lens
