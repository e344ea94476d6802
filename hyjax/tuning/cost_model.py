"""Cost model: a schedule's cost as a sum of the costs of its levels and steps, fitted to times of whole schedules.

The compiled cascade is one program, so its parts cannot be timed one by one. The model is additive,

    t = fixed + Σ (level_l + step_l n_l) + finest_f,

summed over the levels l that have steps, with f the finest of these: its result is upsampled to full size. What any
schedule pays goes to `fixed`. The coefficients are not negative, and errors count relative to the time.

Symbols of this file: *steps* are n_l at each of the factors, coarse to fine, 0 where a level is left out.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from hyjax.util.errors import InputError

Time = Annotated[float, msgspec.Meta(ge=0)]
"""Milliseconds, or a relative error: finite and not negative where it is read from a file."""


@dataclasses.dataclass(frozen=True)
class Milliseconds:
    """Median and 95th percentile of the times of single calls."""

    median: Time
    p95: Time


# No measured time is taken to be shorter, in milliseconds: what the clock's record is rounded to.
SHORTEST = 1e-3


@dataclasses.dataclass(frozen=True)
class CostModel:
    """Additive cost of a schedule, in milliseconds; one entry for each factor, coarse to fine.

    Attributes:
        fixed: what any schedule costs.
        level: for having the level at all: its conductances, and getting there from the level before.
        step: for each of its steps.
        finest: for ending there: upsampling to full size, beyond the part that is in `fixed`.
    """

    fixed: Time
    level: tuple[Time, ...]
    step: tuple[Time, ...]
    finest: tuple[Time, ...]

    def __call__(self, steps: Sequence[int | float]) -> float:
        """Milliseconds for a schedule with these steps over the factors; a level with 0 steps is left out."""
        if len(steps) != len(self.level):
            raise InputError(f"steps: need one number for each of {len(self.level)} levels, got {len(steps)}")
        for value in steps:
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"steps: must be finite and >= 0, got {value}")
        if not any(steps):
            raise InputError("steps: at least one level must have some")
        return float(row_of(steps) @ np.concatenate([[self.fixed], self.level, self.step, self.finest]))


def row_of(steps: Sequence[int | float]) -> Float[np.ndarray, "k"]:
    """Regressors of the coefficients (fixed, levels, steps, finest)."""
    counts = np.asarray(steps, float)
    present = counts > 0
    finest = np.zeros(len(counts))
    finest[np.flatnonzero(present)[-1]] = 1.0
    return np.concatenate([[1.0], present, counts, finest])


def fit(steps: Sequence[Sequence[int]], times: Sequence[float], *, above: CostModel | None = None) -> CostModel:
    """Fit the additive model to times of whole schedules, robustly and relative to the times.

    Huber's weights on the relative residuals, least squares under coefficients ≥ 0 (Lawson and Hanson).

    Args:
        steps: over the factors, one entry for each schedule.
        times: milliseconds, > 0.
        above: a model whose coefficients bound the new ones from below.
    """
    design, measured = np.stack([row_of(row) for row in steps]), np.maximum(np.asarray(times, float), SHORTEST)
    count = len(steps[0])
    low = np.zeros(design.shape[1])
    if above is not None:
        low = np.concatenate([[above.fixed], above.level, above.step, above.finest])
    # The last level is never anything but the finest: the two costs cannot be told apart, `level` has both.
    relative, target = design[:, :-1] / measured[:, None], 1.0 - design @ low / measured
    free = relative.shape[1]
    # A constant may move between `fixed` and all of `finest`: a trace of a penalty decides.
    penalty = 1e-7 * np.diag(np.linalg.norm(relative, axis=0))
    weight = np.ones(len(measured))
    for _ in range(50):
        rows = np.concatenate([relative * weight[:, None], penalty])
        solution, _ = nnls(rows, np.concatenate([target * weight, np.zeros(free)]), maxiter=100 * free)
        residual = np.abs(relative @ solution - target)
        scale = max(1.4826 * float(np.median(residual)), 1e-4)
        new = np.sqrt(np.minimum(1.0, 1.345 * scale / np.maximum(residual, 1e-12)))
        if np.allclose(new, weight, rtol=1e-3):
            break
        weight = new
    values = low + np.append(solution, 0.0)
    fixed, (level, step, finest) = values[0], values[1:].reshape(3, count)
    if above is None:  # what every schedule pays belongs to `fixed`
        shared = min([level[-1], *finest[:-1]])
        fixed, finest[:-1], level[-1] = fixed + shared, finest[:-1] - shared, level[-1] - shared
    return CostModel(float(fixed), tuple(level.tolist()), tuple(step.tolist()), tuple(finest.tolist()))


def leave_one_out(steps: Sequence[Sequence[int]], times: Sequence[float]) -> Float[np.ndarray, "n"]:
    """Relative error of each time when predicted by a model fitted to all the others."""
    errors = []
    for i, row in enumerate(steps):
        model = fit([*steps[:i], *steps[i + 1 :]], [*times[:i], *times[i + 1 :]])
        errors.append(abs(model(row) / times[i] - 1.0))
    return np.array(errors)
