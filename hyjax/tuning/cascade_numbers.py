"""Numbers of a cascade: κ, λ and α of its levels."""

import dataclasses
from typing import Any

import jax
import numpy as np

from hyjax.core.schedule import Schedule


def with_numbers(schedule: Schedule, *, kappa: Any = None, lam: Any = None, fidelity: Any = None) -> Schedule:
    """Schedule with other κ, λ and α, one for all levels or one for each; they may be traced.

    Of a level without steps there is no λ, of one without a fidelity no α.
    """
    count = len(schedule.levels)

    def each(value: Any) -> list[Any]:
        if value is None:
            return [None] * count
        if isinstance(value, jax.Array):
            return list(jax.numpy.broadcast_to(value, (count,)))
        return list(np.broadcast_to(np.asarray(value, np.float32), (count,)))

    levels = []
    for level, own_kappa, own_lam, own_fidelity in zip(schedule.levels, each(kappa), each(lam), each(fidelity)):
        if own_kappa is not None:
            level = dataclasses.replace(level, kappa=own_kappa)
        if own_lam is not None and level.steps:
            level = dataclasses.replace(level, step_sizes=own_lam * np.ones(level.steps, np.float32))
        if own_fidelity is not None and level.fidelity is not None:
            level = dataclasses.replace(level, fidelity=own_fidelity)
        levels.append(level)
    return dataclasses.replace(schedule, levels=tuple(levels))
