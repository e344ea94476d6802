"""Evaluator of a search: quality on cases, times in turns, both kept in a study."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hyjax.configuration import Configuration
from hyjax.tuning.frame.clock import FrameClock
from hyjax.tuning.frame.evaluation import Case, Judge
from hyjax.tuning.frame.refinement import numbers_of, refine_numbers
from hyjax.tuning.frame.search import Trial
from hyjax.tuning.frame.space import Choices, Space, key_of, structure
from hyjax.tuning.frame.study import Study

ROUNDS = 25
"""Frames that a trial is timed on, in turns with the default."""


class StudyEvaluator:
    """What `FrameSearch` asks, answered from frames, or from the study where it was asked before.

    Args:
        space: of the choices.
        judge: of the cases.
        cases: in the order of batches.
        clock: of whole frames.
        study: keeps results.
        progress: called with each iteration of a refinement and its loss.
        expired: whether the time is up.
    """

    def __init__(
        self,
        space: Space,
        judge: Judge,
        cases: Sequence[Case],
        clock: FrameClock,
        study: Study,
        *,
        progress: Callable[[int, float], None] = lambda iteration, loss: None,
        expired: Callable[[], bool] = lambda: False,
    ) -> None:
        self.space, self.judge, self.cases, self.clock, self.study = space, judge, tuple(cases), clock, study
        self._progress, self._expired = progress, expired
        self._default: dict[Case, float] = {}
        self._pending: dict[str, Any] = {}

    def losses(self, choices: Choices, first: int, last: int) -> list[float]:
        """Losses relative to the default's on cases of these numbers."""
        key = f"losses {first}:{last} {key_of(choices)}"
        known = self.study.known(key)
        if known is None:
            known = self.relative(self.space.configuration(choices), self.cases[first:last])
            self._pending[key] = known
        return known

    def relative(self, configuration: Configuration, cases: Sequence[Case]) -> list[float]:
        """Losses of a configuration over the default's."""
        missing = [case for case in cases if case not in self._default]
        if missing:
            rows = self.judge.scores(Configuration(), missing)
            self._default |= {case: row["loss"] for case, row in zip(missing, rows, strict=True)}
        rows = self.judge.scores(configuration, cases)
        return [row["loss"] / max(self._default[case], 1e-9) for row, case in zip(rows, cases, strict=True)]

    def time(self, choices: Choices) -> float:
        """Median time of a frame over the default's, in turns."""
        key = self.study.timed(f"time {structure(choices, self.space)}")
        known = self.study.known(key)
        if known is None:
            (time,) = self.clock.times([self.space.configuration(choices)], ROUNDS)
            known = self._pending[key] = time.ratio
        return float(known)

    def keep(self, trial: Trial) -> None:
        """Add a trial to the study, unless it is there."""
        if self._pending:
            self.study.add(self.space, trial.choices, trial.phase, trial.loss, trial.time or 1.0, self._pending)
            self._pending = {}

    def refine(self, choices: Choices, batch: int) -> Choices:
        """The choices with the numbers that the gradient leads to on the first cases."""

        def compute() -> Choices:
            found = refine_numbers(
                self.space.configuration(choices),
                self.judge,
                self.cases[:batch],
                report=self._progress,
                expired=self._expired,
            )
            numbers = {name: float(np.asarray(value)) for name, value in numbers_of(found, levels=False).items()}
            inside = {p.name: p for p in self.space.parameters if p.name in numbers}
            return choices | {
                name: float(np.clip(numbers[name], *p.values)) for name, p in inside.items() if name in choices
            }

        key = f"refined {batch} {key_of(choices)}"
        return self.space.complete(self.study.remember(key, compute, expired=self._expired))
