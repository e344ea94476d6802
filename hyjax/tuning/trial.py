"""Trial of a search: choices that are to be judged, or were."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeVar

import numpy as np

from hyjax.tuning.space import Choices

Improvement = Literal["", "numbers", "relaxed"]
T = TypeVar("T")


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
    timed = [trial for trial in trials if trial.time is not None and len(trial.losses) >= cases]
    return unbeaten(timed, lambda trial: (trial.time or 0.0, trial.loss))


def unbeaten(several: Iterable[T], place: Callable[[T], tuple[float, float]]) -> list[T]:
    """Those that no other beats in both numbers of its place, such as time and loss, by the first number."""
    found: list[T] = []
    for each in sorted(several, key=place):
        if not found or place(each)[1] < place(found[-1])[1]:
            found.append(each)
    return found
