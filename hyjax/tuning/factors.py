"""Downsampling factors that schedules may use, and the key of a schedule's time.

*Factors* are a row, coarse to fine; *steps* over them are a number for each, 0 where a level is left out.
"""

import itertools
from collections.abc import Sequence

from hyjax.core.pyramid import level_shape
from hyjax.core.schedule import Schedule
from hyjax.util.errors import InputError

FACTORS = (32, 16, 8, 4, 2, 1)
# Cells that the shorter side of a level must have to be worth a place among the factors. The paper's coarsest
# has 32 of them; one more level costs compilation and is hardly ever part of a good schedule.
FEWEST_CELLS = 24


def factors_for(height: int, width: int, factors: Sequence[int] = FACTORS) -> tuple[int, ...]:
    """Those of the factors that are not too coarse for a picture of this size."""
    check_factors(factors)
    fitting = tuple(f for f in factors if f == 1 or min(level_shape((height, width), f)) >= FEWEST_CELLS)
    if not fitting:
        raise InputError(f"factors: each of {tuple(factors)} is too coarse for {height}x{width} pixels")
    return fitting


def check_factors(factors: Sequence[int]) -> None:
    """Raise `InputError` unless a schedule can have these factors."""
    whole = all(isinstance(f, int) and not isinstance(f, bool) and f >= 1 for f in factors)
    if not factors or not whole or any(c <= f or c % f for c, f in itertools.pairwise(factors)):
        raise InputError(f"factors: they must fall, each a multiple of the next, got {tuple(factors)}")


def schedule_key(schedule: Schedule) -> str:
    """Key of a schedule's time: `16:5 8:10`, factor and steps, and deviations from the paper's form."""
    text = " ".join(f"{level.factor}:{level.steps}" for level in schedule.levels)
    if schedule.pooling != "edges":
        text += f" pooling={schedule.pooling}"
    if schedule.norm != "l2":
        text += f" norm={schedule.norm}"
    if schedule.upsampling != "bilinear":
        text += f" upsampling={schedule.upsampling}"
    if any(level.fidelity is not None for level in schedule.levels):
        text += " attached"
    return text
