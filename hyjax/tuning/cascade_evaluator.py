"""Evaluator of trials of the diffusion alone: losses by the relaxed cascade, times by a latency table."""

from collections.abc import Callable, Sequence

import numpy as np

from hyjax.configuration import Configuration
from hyjax.tuning.descent import Objective, polish
from hyjax.tuning.frame.evaluator import Evaluator
from hyjax.tuning.frame.relaxed import UNLIMITED_STEPS, relaxed_points, with_point
from hyjax.tuning.frame.space import Choices, Space
from hyjax.tuning.frame.trial import Trial
from hyjax.tuning.latency_estimator import ScheduleClock
from hyjax.tuning.relaxation import RelaxedSchedule, evaluate, relaxed_of

ITERATIONS = 30
"""Iterations of a relaxed descent, one frame each."""
LOOKED_AT = 16
"""Whole steps around the start, and around the end of the descent, of which the loss is computed."""
POLISHING = 8
"""Iterations of the quasi-Newton steps on the numbers of a schedule."""
POLISHED = 1
"""Number of these, the best, whose numbers are refined before one is chosen."""
NEVER = 1e6
"""Time over the default's of no steps at all, which no budget allows."""


class CascadeEvaluator(Evaluator):
    """Judge of trials of the diffusion alone.

    One compiled program has the losses of all trials, since their steps are its arguments.

    Args:
        space: of the choices.
        objective: of the frames.
        clock: of schedules, whose model predicts times.
        seed: of the relaxation.
        expired: whether the time is up.
    """

    def __init__(
        self,
        space: Space,
        objective: Objective,
        clock: ScheduleClock,
        *,
        seed: int = 0,
        expired: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(space, range(len(objective.prepared)), seed=seed, expired=expired)
        self.objective, self._model = objective, clock.cost
        self._usual = self._model(self._steps(space.default))
        self.cost = self.time

    def relative(self, configuration: Configuration, cases: Sequence[int]) -> list[float]:
        factors = self.objective.factors
        prepared, own = self.objective.prepared, relaxed_of(configuration.schedule, factors)
        for case in cases:
            if case not in self._default:
                self._default[case] = float(evaluate(self._point(self.space.default), prepared[case], factors))
        return [float(evaluate(own, prepared[x], factors)) / max(self._default[x], 1e-9) for x in cases]

    def time(self, choices: Choices) -> float:
        steps = self._steps(choices)
        return self._model(steps) / self._usual if any(steps) else NEVER

    def refined(self, choices: Choices, batch: int) -> Choices:
        start = self._point(choices)
        if not np.any(np.asarray(start.steps)):
            return choices
        return self._with(choices, polish(self._first(batch), start, POLISHING).point)

    def relaxed(self, choices: Choices, trial: Trial) -> Choices:
        budget = trial.budget * self._usual
        if not np.isfinite(budget):
            budget = UNLIMITED_STEPS * self.time(choices) * self._usual
        objective = self._first(trial.cases)
        found = relaxed_points(
            objective,
            self._point(choices),
            self._model,
            budget,
            iterations=ITERATIONS,
            looked_at=LOOKED_AT,
            seed=self._seed,
            expired=self._expired,
        )
        if not found:
            return choices
        polished = [polish(objective, each.point, POLISHING) for each in found[:POLISHED] if not self._expired()]
        return self._with(choices, min([*polished, found[0]], key=lambda each: each.loss).point)

    def _first(self, count: int) -> Objective:
        return Objective(self.objective.prepared[:count], self.objective.factors)

    def _steps(self, choices: Choices) -> tuple[int, ...]:
        return tuple(choices.get(f"cascade_{factor}", 0) for factor in self.objective.factors)

    def _point(self, choices: Choices) -> RelaxedSchedule:
        return relaxed_of(self.space.configuration(choices).schedule, self.objective.factors)

    def _with(self, choices: Choices, point: RelaxedSchedule) -> Choices:
        return with_point(choices, self.space, point, self.objective.factors)
