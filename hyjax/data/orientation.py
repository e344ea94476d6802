"""Frames taken sideways or upside down, turned upright by quarter turns. The world does not move."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Frame

Z_UP = np.array([0.0, 0.0, 1.0])
# World-up along the camera's x and y axes when the picture needs 0, 1, 2, 3 quarter turns clockwise.
UP_IN_PICTURE = np.array([[0.0, -1.0], [-1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])


def turns_upright(poses: Iterable[Float[np.ndarray, "4 4"]], up: Float[np.ndarray, "3"] = Z_UP) -> int:
    """Clockwise quarter turns (0 to 3) after which most pictures are upright.

    One number for all, so that all pictures have one size.

    Args:
        poses: camera-to-world.
        up: unit vector against gravity in world coordinates.
    """
    votes = [int(np.argmax(UP_IN_PICTURE @ (up @ pose[:3, :2]))) for pose in poses]
    return int(np.argmax(np.bincount(votes, minlength=4)))


def turn_frame(frame: Frame, quarters: int) -> Frame:
    """The frame turned clockwise by quarter turns: picture, depth, confidence, intrinsics and the camera's axes."""
    depth = None if frame.depth is None else turn_picture(frame.depth, quarters)
    lens = None if frame.depth_intrinsics is None else frame.depth_intrinsics.turned(quarters)
    return dataclasses.replace(
        frame,
        image=turn_picture(frame.image, quarters),
        camera=frame.camera.turned(quarters),
        depth=depth,
        depth_intrinsics=lens,
        confidence=None if frame.confidence is None else turn_picture(frame.confidence, quarters),
    )


def turn_picture(pixels: Float[np.ndarray, "h w *c"], quarters: int) -> Float[np.ndarray, "h2 w2 *c"]:
    """Pixels turned clockwise by quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -quarters))
