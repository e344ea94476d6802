"""The best schedule inside a budget: relax, round exactly, polish, descend."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hyjax.tuning.budget import Steps, fits, moves, neighbours, project, single_steps
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.descent import Found, Objective, polish, promising, relax, starts, whole, with_steps
from hyjax.tuning.relaxation import RelaxedSchedule


@dataclasses.dataclass(frozen=True)
class Effort:
    """How long to look.

    Attributes:
        sampled: starting points looked at.
        relaxed: of these, how many are relaxed.
        iterations: of the relaxation, one frame each.
        rounded: integer neighbours of the relaxed optimum that are evaluated.
        polished: how many of these get their κ, λ and α polished.
        polishing: iterations of the polishing, all frames each.
        descents: rounds of looking at all neighbours of the best.
    """

    sampled: int = 16
    relaxed: int = 3
    iterations: int = 30
    rounded: int = 24
    polished: int = 2
    polishing: int = 8
    descents: int = 3


QUICK = Effort(sampled=8, relaxed=1, iterations=20, rounded=12, polished=1, polishing=6, descents=1)
"""For budgets that only complete the curve of quality against time, with schedules of others to start from."""
AGAIN = Effort(sampled=0, relaxed=1, iterations=10, rounded=12, polished=1, polishing=5, descents=1)
"""For moving the best to a slightly different budget."""


class _CutShort(Exception):
    """The time was up before the relaxation was through."""

    def __init__(self, point: RelaxedSchedule) -> None:
        super().__init__()
        self.point = point


class Search:
    """Search for schedules within budgets, on one objective and one cost model; deterministic, given the seed.

    Args:
        objective: what is minimised.
        cost: milliseconds of a schedule.
        seed: of starting points and frame order.
        remember: called as `remember(key, compute)`; returns `compute()` (JSON's types), or what it returned
            for the same key in an interrupted run.
        report: called with (phase, loss) for everything that is evaluated.
        expired: whether the time is up; asked between the parts of the work.
    """

    def __init__(
        self,
        objective: Objective,
        cost: CostModel,
        *,
        seed: int = 0,
        remember: Callable[[str, Callable[[], Any]], Any] = lambda key, compute: compute(),
        report: Callable[[str, float], None] = lambda phase, loss: None,
        expired: Callable[[], bool] = lambda: False,
    ) -> None:
        self.objective, self.cost, self.seed = objective, cost, seed
        self.remember, self.report, self.expired = remember, report, expired
        self.found: dict[bytes, Found] = {}
        self._losses: dict[bytes, float] = {}

    def run(self, budget: float, effort: Effort | None = None, warm: Sequence[RelaxedSchedule] = ()) -> list[Found]:
        """All that was evaluated so far and lies within the budget, best first; empty if nothing can.

        Args:
            budget: milliseconds, against the cost model.
            effort: how long to look.
            warm: points to start from besides the usual ones, projected within the budget.
        """
        effort, size = effort or Effort(), len(self.cost.step)
        if not any(fits(steps, self.cost, budget) for steps in single_steps(size)):
            return []
        for point in self._relaxed(budget, effort, warm):
            real = np.asarray(point.steps)
            near = neighbours(real, self.cost, budget, maximal=self.cost(real.tolist()) > 0.95 * budget)
            if len(near) > effort.rounded:
                near = promising(near, point, self.objective.gradient(point)[1], effort.rounded)
            for steps in near[: 1 if self.expired() else None]:
                self._evaluate(with_steps(point, steps), "round")
        for found in self.ranked(budget)[: effort.polished]:
            self._polish(found.point, effort)
        for _ in range(effort.descents):
            if not self._descend(budget, effort):
                break
        return self.ranked(budget)

    def _descend(self, budget: float, effort: Effort) -> bool:
        """Look at all neighbours of the best; polish the best of them if it is better. Whether it was."""
        best = self.ranked(budget)[0]
        for steps in moves(best.steps, self.cost, budget):
            if self.expired():
                break
            self._evaluate(with_steps(best.point, steps), "descend")
        better = self.ranked(budget)[0]
        if better.steps == best.steps:
            return False
        self._polish(better.point, effort)
        return True

    def ranked(self, budget: float) -> list[Found]:
        """All that was evaluated and fits, best first, the best κ, λ and α of each step counts only."""
        best: dict[Steps, Found] = {}
        for found in sorted(self.found.values(), key=lambda f: f.loss):
            if found.steps not in best and fits(found.steps, self.cost, budget):
                best[found.steps] = found
        return list(best.values())

    def _relaxed(self, budget: float, effort: Effort, warm: Sequence[RelaxedSchedule]) -> list[RelaxedSchedule]:
        """The better half of the relaxed starting points."""
        cold = starts(effort.sampled, self.cost, budget, self.seed)
        projected = [with_steps(point, project(np.asarray(point.steps), self.cost, budget)) for point in warm]
        candidates = [point for point in (*projected, *cold) if np.any(np.asarray(point.steps) > 0)]
        rounded = [with_steps(point, whole(point)) for point in projected]
        rounded = [point for point in rounded if fits(whole(point), self.cost, budget)] + cold
        for point in rounded[: 1 if self.expired() else None]:
            self._evaluate(point, "start")
        relaxed = []
        if self.expired():
            return candidates[:1]
        for point in self._spread(candidates, budget, effort.relaxed):
            if self.expired():
                relaxed.append(point)
                break
            key = f"relax {effort.iterations} {budget!r} {self.cost} {_bytes(point).hex()}"
            try:
                relaxed.append(_point(self.remember(key, functools.partial(self._relax, point, budget, effort))))
            except _CutShort as cut:  # not remembered: a resumed run has more time
                relaxed.append(cut.point)
            self.report("relax", self._loss(relaxed[-1]))
        relaxed = [point for point in relaxed if np.any(np.asarray(point.steps) > 0)]  # not those that gave up all
        return self._best(relaxed, (len(relaxed) + 1) // 2)

    def _spread(self, points: Sequence[RelaxedSchedule], budget: float, count: int) -> list[RelaxedSchedule]:
        """The best of those that spend much of the budget and of those that spend little, by turns, much first.

        Before κ is tuned a few steps may look better than many, which have more to gain from it.
        """
        much = [self.cost(np.asarray(point.steps).tolist()) > 0.4 * budget for point in points]
        groups = [self._best([p for p, m in zip(points, much) if m is wanted], count) for wanted in (True, False)]
        turns = itertools.chain.from_iterable(itertools.zip_longest(*groups))
        return [point for point in turns if point is not None][:count]

    def _best(self, points: Sequence[RelaxedSchedule], count: int) -> list[RelaxedSchedule]:
        losses = [self._loss(point) for point in points]
        return [points[i] for i in np.argsort(losses, kind="stable")[:count]]

    def _relax(self, start: RelaxedSchedule, budget: float, effort: Effort) -> list[list[float]]:
        cost, iterations = self.cost, effort.iterations
        point = relax(self.objective, start, cost, budget, iterations, self.seed, self.expired)
        if self.expired():
            raise _CutShort(point)
        return _lists(point)

    def _loss(self, point: RelaxedSchedule) -> float:
        key = _bytes(point)
        if key not in self._losses:
            self._losses[key] = self.remember(f"loss {key.hex()}", lambda: self.objective(point))
        return self._losses[key]

    def _evaluate(self, point: RelaxedSchedule, phase: str) -> None:
        key = _bytes(point)
        if key not in self.found:
            self.found[key] = Found(point, self._loss(point))
            self.report(phase, self.found[key].loss)

    def _polish(self, point: RelaxedSchedule, effort: Effort) -> None:
        if self.expired() or effort.polishing == 0:
            return

        def compute() -> Any:
            found = polish(self.objective, point, effort.polishing)
            return [_lists(found.point), found.loss]

        lists, loss = self.remember(f"polish {effort.polishing} {_bytes(point).hex()}", compute)
        polished = _point(lists)
        self.found[_bytes(polished)] = Found(polished, loss)
        self.report("polish", loss)


def _bytes(point: RelaxedSchedule) -> bytes:
    return np.concatenate([np.asarray(x, np.float32) for x in jax.tree.leaves(point)]).tobytes()


def _lists(point: RelaxedSchedule) -> list[list[float]]:
    return [[float(x) for x in np.asarray(leaf)] for leaf in jax.tree.leaves(point)]


def _point(lists: list[list[float]]) -> RelaxedSchedule:
    leaves: list[Array] = [jnp.asarray(values, jnp.float32) for values in lists]
    return RelaxedSchedule(*leaves)
