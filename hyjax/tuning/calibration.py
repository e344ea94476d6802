"""Calibration: some thirty schedules, timed in turns, from which the costs of all others follow."""

import concurrent.futures
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from hyjax.core.refine import cascade_known
from hyjax.core.schedule import PRESETS, Schedule, guided_schedule
from hyjax.util.environment import cores

# Large pictures get fewer rounds instead of minutes.
MOST_SECONDS = 30.0

Arguments = tuple[Float[Array, "h w lights"], Float[Array, "h w 1"], Float[Array, "h w f"]]
"""Filter, confidence and guide that a cascade is timed on."""

# Steps by factor that make a level's steps cost about as much as the rest of a single-level schedule.
MANY_STEPS = {1: 10, 2: 24, 4: 40, 8: 80}
MANY_COARSE_STEPS = 240
FEW_STEPS = 2


def schedule_of(factors: Sequence[int], steps: Sequence[int]) -> Schedule:
    """The schedule with these steps over the factors, of the form that is searched."""
    return guided_schedule([(factor, count) for factor, count in zip(factors, steps) if count])


def probe_steps(factors: Sequence[int]) -> tuple[int, ...]:
    """The paper's 50 steps at those of their levels that are among the factors; two a level if none is."""
    paper = dict(PRESETS["paper-50"].steps)
    steps = tuple(paper.get(factor, 0) for factor in factors)
    return steps if any(steps) else (FEW_STEPS,) * len(factors)


def calibration_steps(factors: Sequence[int]) -> list[tuple[int, ...]]:
    """Schedules from whose times the costs of all others follow, as steps over the factors.

    Each level alone with few and with many steps, every entry and every finest level of longer long, two
    schedules of the paper, every other level, and some mixtures, so that all coefficients can be told apart and an
    outlier cannot carry one of them alone.
    """
    count = len(factors)
    many = [MANY_STEPS.get(factor, MANY_COARSE_STEPS) for factor in factors]
    rng = np.random.default_rng(0)

    def mixed(present: Iterable[int]) -> tuple[int, ...]:
        chosen = set(present)
        return tuple(
            int(rng.integers(FEW_STEPS, max(most // 2, 3))) if i in chosen else 0 for i, most in enumerate(many)
        )

    rows = [probe_steps(factors)]
    paper = dict(PRESETS["paper-80"].steps)
    rows += [tuple(paper.get(factor, 0) for factor in factors)]
    for i in range(count):
        rows += [tuple(steps if j == i else 0 for j in range(count)) for steps in (FEW_STEPS, many[i])]
    rows += [mixed(range(i, count)) for i in range(count - 1)]  # every entry
    rows += [mixed(range(i + 1)) for i in range(1, count - 1)]  # every finest level
    rows += [mixed(range(0, count, 2)), mixed(range(1, count, 2))]
    rows += [mixed((i, i + 1)) for i in range(1, count - 1)]
    return [row for row in dict.fromkeys(rows) if any(row)]


def compile_all(schedules: Sequence[Schedule], arguments: Arguments, *, progress: bool) -> list[Callable[[], Any]]:
    """`cascade_known` compiled for each schedule, with its arguments bound and already on the device.

    Two at a time; all are ready before anything is timed.
    """
    y, confidence, guide = arguments

    def compiled(schedule: Schedule) -> Callable[[], Any]:
        schedule = jax.device_put(schedule)
        return functools.partial(
            jax.jit(cascade_known).lower(y, confidence, guide, schedule).compile(), y, confidence, guide, schedule
        )

    with concurrent.futures.ThreadPoolExecutor(min(2, cores())) as pool:
        ready = pool.map(compiled, schedules)  # which an error ends
        return [*tqdm(ready, "compiling", len(schedules), unit="schedule", leave=False, disable=not progress)]
