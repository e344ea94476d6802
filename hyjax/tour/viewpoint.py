"""Viewpoint of a visitor: frame, or a camera beside it, stage to show, and schedule of the diffusion."""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float

from hyjax.core.schedule import Schedule
from hyjax.geometry.camera import Camera

KAPPA_RANGE, MOST_STEPS = 1.5, 4.0
"""Largest power of ten of the factor on κ, and largest factor on the number of steps."""
Shown = Literal[
    "relit", "photo", "normals", "depth", "raw filter", "refined filter", "visibility", "conductances", "holes"
]


@dataclasses.dataclass(frozen=True, eq=False)
class Viewpoint:
    """Frame number, stage to show, schedule of the diffusion, and a camera that has left the frame's."""

    frame: int
    shown: Shown
    schedule: Schedule
    camera: Camera | None = None


def scale_schedule(schedule: Schedule, steps: float, kappa: float) -> Schedule:
    """Schedule with `steps` times as many steps and `kappa` times the edge sensitivity."""
    levels = []
    for level in schedule.levels:
        step_sizes = scale_step_count(np.asarray(level.step_sizes), steps)
        levels.append(
            dataclasses.replace(level, step_sizes=step_sizes, kappa=np.float32(np.asarray(level.kappa) * kappa))
        )
    return dataclasses.replace(schedule, levels=tuple(levels))


def scale_step_count(step_sizes: Float[np.ndarray, "n"], times: float) -> Float[np.ndarray, "m"]:
    """Step sizes for `times` as many steps; cycles of varying step sizes are repeated whole, as they must be."""
    if len(set(step_sizes.tolist())) > 1:
        return np.tile(step_sizes, max(round(times), int(times > 0)))
    return np.resize(step_sizes, round(len(step_sizes) * times)) if len(step_sizes) else step_sizes
