"""Clocks that stand in for this machine's in tuning runs: steady, or of few rounds."""

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from hyjax import Schedule
from hyjax.tuning import calibration
from hyjax.tuning.factors import schedule_key
from hyjax.util import clock as latency

ROUGHNESS = 0.02
"""Of the steady clock: no sum of levels and steps gives its times exactly, as on a real machine."""


def machine_time(key: str) -> float:
    """Milliseconds of a schedule by its `schedule_key`: 0.5, 0.2 a level, and for each step 1 / factor².

    Twice that for the paper's form, of which the model of the searched form knows nothing; and a little more or
    less from schedule to schedule, by `ROUGHNESS`, which the additive model cannot know.
    """
    words = key.split()
    levels = [tuple(map(int, word.split(":"))) for word in words if ":" in word]
    form = 1.0 if "upsampling=guide" in words else 2.0
    rough = 1.0 + ROUGHNESS * np.sin(7.0 * sum(steps for _, steps in levels) + 3.0 * len(levels))
    return float(form * rough * (0.5 + sum(0.2 + steps / factor**2 for factor, steps in levels)))


def steady_clock(patch: pytest.MonkeyPatch, slowness: float = 1.0) -> None:
    """Schedules take what `machine_time` says, everything else 0.1 ms; nothing is compiled to be timed."""

    def compile_all(schedules: Sequence[Schedule], *_: object, **__: object) -> list[Callable[[], str]]:
        return [functools.partial(str, schedule_key(schedule)) for schedule in schedules]

    def measure_each(calls: Mapping[str, Callable[[], Any]], repeats: int, **_: object) -> dict[str, dict]:
        times = {}
        for name, call in calls.items():
            time = 0.1
            if isinstance(call, functools.partial) and call.func is str:
                time = slowness * machine_time(call.args[0])
            elif match := re.match(r"whole frame (.*) G-buffer \(", name):
                time = 0.6 + slowness * machine_time(match[1])
            times[name] = {"first_ms": 9.0, "count": repeats, "median_ms": time, "p95_ms": 1.1 * time}
        return times

    patch.setattr(calibration, "compile_all", compile_all)
    patch.setattr(latency, "measure_each", measure_each)


def few_rounds(patch: pytest.MonkeyPatch) -> None:
    """Whole frames are timed in three rounds each."""
    for name in ("evaluator.ROUNDS", "stage.BASE_ROUNDS", "proof.ROUNDS", "run.ROUNDS"):
        patch.setattr(f"hyjax.tuning.{name}", 3)
