"""Trial of a search: choices that are to be judged, or were."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from hyjax.tuning.space import Choices

Improvement = Literal["", "numbers", "relaxed"]


@dataclasses.dataclass(frozen=True)
class Trial:
    """Choices that are to be tried, or were.

    Attributes:
        phase: part of the search that asked for it.
        losses: on the cases so far, in their order, relative to the default's.
        time: of a frame, relative to the default's; None if it was not timed.
        cases: number of cases to judge it on.
        improve: whether gradients move its numbers first, or its levels and steps, too.
        source: key of the choices that these were made from by gradients.
        budget: that it was proposed for.
        predicted: time that the surrogate expects.
    """

    choices: Choices
    phase: str
    losses: tuple[float, ...] = ()
    time: float | None = None
    cases: int = 0
    improve: Improvement = ""
    source: str = ""
    budget: float = math.inf
    predicted: float | None = None

    @property
    def loss(self) -> float:
        """Geometric mean of the losses."""
        return float(np.exp(np.mean(np.log(self.losses)))) if self.losses else math.inf


def front_of_trials(trials: Sequence[Trial], *, cases: int = 1) -> list[Trial]:
    """Timed trials on at least so many cases that no other of them beats in both time and loss, by time."""
    found: list[Trial] = []
    done: list[Any] = [(trial.time, trial.loss, trial) for trial in trials if trial.time is not None]
    for _, loss, trial in sorted((each for each in done if len(each[2].losses) >= cases), key=lambda e: e[:2]):
        if not found or loss < found[-1].loss:
            found.append(trial)
    return found
