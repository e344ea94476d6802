"""Frames written as a capture in the 7-Scenes layout, without depth."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Frame
from hyjax.util.images import write_png


def export_seven_scenes(frames: Iterable[Frame], up: Float[np.ndarray, "3"], folder: Path) -> Path:
    """Write frames of one camera, numbered from 0, into a new folder, and return it."""
    folder.mkdir()
    for number, frame in enumerate(frames):
        write_png(folder / f"frame-{number:06d}.color.png", frame.image)
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", frame.camera.pose)
    np.savetxt(folder / "camera-intrinsics.txt", frame.camera.intrinsics.matrix)
    np.savetxt(folder / "gravity-direction.txt", -up)
    return folder
