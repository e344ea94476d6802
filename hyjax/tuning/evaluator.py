"""Evaluators of trials: their losses and times, and the improvements by gradients that they ask for."""

import abc
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hyjax.configuration import Configuration
from hyjax.tuning.clock import Clock
from hyjax.tuning.descent import Objective, polish
from hyjax.tuning.evaluation import FrameCase, Judge
from hyjax.tuning.proposal import UNLIMITED_STEPS, Price, relaxed_choices, relaxed_points, with_point
from hyjax.tuning.refinement import numbers_of, refine_numbers
from hyjax.tuning.relaxation import RelaxedSchedule, evaluate, relaxed_of
from hyjax.tuning.schedule_clock import ScheduleClock
from hyjax.tuning.space import Choices, Space, key_of, structure
from hyjax.tuning.study import Study
from hyjax.tuning.trial import Trial
from hyjax.util.programs import forget_programs_in_time

ROUNDS = 12
"""Frames that a trial is timed on, in turns with the default."""
RELAXED_CASES = 4
"""Cases of the first batch that a relaxation looks at."""
PRICED_STEPS = 24
"""Steps more at one level, from whose time the price of a step follows."""


class Evaluator(abc.ABC):
    """Judge of trials: losses relative to the default's on cases, and times."""

    cost: Callable[[Choices], float] | None = None
    """Time of choices over the default's, where it is known without measuring."""
    say: Callable[[str], None] = staticmethod(lambda words: None)
    """Called with how far a long trial has come."""

    def __init__(self, space: Space, cases: Sequence[Any], seed: int, expired: Callable[[], bool]) -> None:
        self.space, self.cases, self._seed, self._expired = space, tuple(cases), seed, expired
        self._default: dict[Any, float] = {}
        self._judged: dict[str, tuple[float, ...]] = {}

    def __call__(self, trial: Trial) -> Trial:
        """The trial, made better by gradients if it asks for that, with losses on its cases and a time."""
        forget_programs_in_time()
        choices = trial.choices
        if trial.improve == "numbers":
            choices = self.refined(choices, trial.cases)
        elif trial.improve == "relaxed":
            choices = self.relaxed(choices, trial)
        known = self._judged.get(key := key_of(choices), ())
        losses = known + self.losses(choices, len(known), max(trial.cases, len(known)))
        self._judged[key] = losses
        return dataclasses.replace(trial, choices=choices, losses=losses, time=self.time(choices))

    def losses(self, choices: Choices, first: int, last: int) -> tuple[float, ...]:
        """Losses relative to the default's on cases of these numbers."""
        return tuple(self.relative(self.space.configuration(choices), self.cases[first:last]))

    def known(self, trial: Trial) -> Trial:
        """A trial of a study with its time here."""
        self._judged[key_of(trial.choices)] = trial.losses
        return dataclasses.replace(trial, time=self.time(trial.choices))

    @abc.abstractmethod
    def relative(self, configuration: Configuration, cases: Sequence[Any]) -> list[float]:
        """Losses of a configuration over the default's."""

    @abc.abstractmethod
    def time(self, choices: Choices) -> float:
        """Time of choices over the default's."""

    @abc.abstractmethod
    def refined(self, choices: Choices, batch: int) -> Choices:
        """Choices with numbers improved by gradients on the first cases."""

    @abc.abstractmethod
    def relaxed(self, choices: Choices, trial: Trial) -> Choices:
        """The choices with the levels and steps of a relaxation within the trial's budget."""


class StudyEvaluator(Evaluator):
    """Judge of trials on whole frames."""

    def __init__(
        self,
        space: Space,
        judge: Judge,
        cases: Sequence[FrameCase],
        clock: Clock,
        study: Study,
        *,
        seed: int = 0,
        expired: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(space, cases, seed, expired)
        self.judge, self.clock, self.study = judge, clock, study
        # What differs from the default in numbers alone takes as long, if what is not searched is the default's.
        usual = not (space.paper or space.fixed)
        self._times: dict[str, float] = {structure(space.default, space): 1.0} if usual else {}

    def relative(self, configuration: Configuration, cases: Sequence[Any]) -> list[float]:
        if missing := [case for case in cases if case not in self._default]:
            rows = self.judge.scores(Configuration(), missing)
            self._default |= {case: row["loss"] for case, row in zip(missing, rows, strict=True)}
        rows = self.judge.scores(configuration, cases) if cases else []
        return [row["loss"] / max(self._default[case], 1e-9) for row, case in zip(rows, cases, strict=True)]

    def time(self, choices: Choices) -> float:
        """Median time of a frame over the default's, in turns."""
        key = structure(choices, self.space)
        if key not in self._times:
            (time,) = self.clock.times([self.space.configuration(choices)], ROUNDS)
            self._times[key] = time.ratio
        return self._times[key]

    def known(self, trial: Trial) -> Trial:
        if trial.time is not None:
            self._times.setdefault(structure(trial.choices, self.space), trial.time)
        return super().known(trial)

    def refined(self, choices: Choices, batch: int) -> Choices:
        """Choices with numbers improved by gradients on the first cases.

        The default's numbers are shared by all levels; of other choices each level has its own.
        """
        levels = choices != self.space.default
        found = refine_numbers(
            self.space.configuration(choices),
            self.judge,
            self.cases[:batch],
            levels=levels,
            held=self.space.fixed.keys(),
            report=lambda iteration, loss: self.say(f"numbers, iteration {iteration}"),
            expired=self._expired,
        )
        changed = dict(choices)
        for name, value in numbers_of(found, levels=levels).items():
            parameter = self.space.named.get(name)
            if parameter is not None and name in choices:
                numbers = np.clip(np.atleast_1d(np.asarray(value, float)), *parameter.values).tolist()
                changed[name] = tuple(numbers) if len(numbers) > 1 else numbers[0]
        return self.space.complete(changed)

    def relaxed(self, choices: Choices, trial: Trial) -> Choices:
        return relaxed_choices(
            choices,
            self.space,
            self.judge,
            self.cases[: min(trial.cases, RELAXED_CASES)],
            price=self._price(),
            room=trial.budget - self.time(choices) if math.isfinite(trial.budget) else math.inf,
            seed=self._seed,
            expired=self._expired,
        )

    def _price(self) -> Price:
        """Time of a step at each factor, from that of many at one level: a level has 1 / factor² of the pixels."""

        def compute() -> Any:
            usual = self.space.default
            more = self.space.complete(usual | {"cascade_4": usual["cascade_4"] + PRICED_STEPS})
            (time,) = self.clock.times([self.space.configuration(more)], ROUNDS)
            return max((time.ratio - self.time(usual)) / PRICED_STEPS, 1e-4)

        price = float(self.study.remember(self.study.timed("price of a step"), compute))
        return {p.factor: price * (4 / p.factor) ** 2 for p in self.space.parameters if p.cascade == "cascade"}


ITERATIONS = 30
"""Iterations of a relaxed descent, one frame each."""
CHECKED_POINTS = 16
"""Whole steps around the start, and around the end of the descent, of which the loss is computed."""
POLISH_ITERATIONS = 8
"""Iterations of the quasi-Newton steps on the numbers of a schedule."""
POLISHED_SCHEDULES = 1
"""Number of these, the best, whose numbers are refined before one is chosen."""
UNREACHABLE_TIME = 1e6
"""Time over the default's of no steps at all, which no budget allows."""


class CascadeEvaluator(Evaluator):
    """Judge of trials of the diffusion alone.

    One compiled program has the losses of all trials, since their steps are its arguments.
    """

    def __init__(
        self, space: Space, objective: Objective, clock: ScheduleClock, seed: int, expired: Callable[[], bool]
    ) -> None:
        super().__init__(space, range(len(objective.prepared)), seed, expired)
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
        return self._model(steps) / self._usual if any(steps) else UNREACHABLE_TIME

    def refined(self, choices: Choices, batch: int) -> Choices:
        start = self._point(choices)
        if not np.any(np.asarray(start.steps)):
            return choices
        return self._with(choices, polish(self._first(batch), start, POLISH_ITERATIONS, self._expired).point)

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
            looked_at=CHECKED_POINTS,
            seed=self._seed,
            expired=self._expired,
        )
        if not found:
            return choices
        polished = [
            polish(objective, each.point, POLISH_ITERATIONS, self._expired)
            for each in found[:POLISHED_SCHEDULES]
            if not self._expired()
        ]
        return self._with(choices, min([*polished, found[0]], key=lambda each: each.loss).point)

    def _first(self, count: int) -> Objective:
        return Objective(self.objective.prepared[:count], self.objective.factors)

    def _steps(self, choices: Choices) -> tuple[int, ...]:
        return tuple(choices.get(f"cascade_{factor}", 0) for factor in self.objective.factors)

    def _point(self, choices: Choices) -> RelaxedSchedule:
        return relaxed_of(self.space.configuration(choices).schedule, self.objective.factors)

    def _with(self, choices: Choices, point: RelaxedSchedule) -> Choices:
        return with_point(choices, self.space, point, self.objective.factors)
