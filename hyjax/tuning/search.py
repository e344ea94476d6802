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
from hyjax.tuning.relaxation import Plan


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

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self.plan = plan


class Search:
    """Looks for schedules within budgets, on one objective and one cost model. Deterministic, given the seed.

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

    def run(self, budget: float, effort: Effort | None = None, warm: Sequence[Plan] = ()) -> list[Found]:
        """All that was evaluated so far and lies within the budget, best first; empty if nothing can.

        Args:
            budget: milliseconds, against the cost model.
            effort: how long to look.
            warm: plans to start from besides the usual ones, brought within the budget.
        """
        effort, size = effort or Effort(), len(self.cost.step)
        if not any(fits(steps, self.cost, budget) for steps in single_steps(size)):
            return []
        for plan in self._relaxed(budget, effort, warm):
            real = np.asarray(plan.steps)
            near = neighbours(real, self.cost, budget, maximal=self.cost(real.tolist()) > 0.95 * budget)
            if len(near) > effort.rounded:
                near = promising(near, plan, self.objective.gradient(plan)[1], effort.rounded)
            for steps in near[: 1 if self.expired() else None]:
                self._evaluate(with_steps(plan, steps), "round")
        for found in self.ranked(budget)[: effort.polished]:
            self._polish(found.plan, effort)
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
            self._evaluate(with_steps(best.plan, steps), "descend")
        better = self.ranked(budget)[0]
        if better.steps == best.steps:
            return False
        self._polish(better.plan, effort)
        return True

    def ranked(self, budget: float) -> list[Found]:
        """All that was evaluated and fits, best first, the best κ, λ and α of each step counts only."""
        best: dict[Steps, Found] = {}
        for found in sorted(self.found.values(), key=lambda f: f.loss):
            if found.steps not in best and fits(found.steps, self.cost, budget):
                best[found.steps] = found
        return list(best.values())

    def _relaxed(self, budget: float, effort: Effort, warm: Sequence[Plan]) -> list[Plan]:
        """The better half of the relaxed starting points."""
        cold = starts(effort.sampled, self.cost, budget, self.seed)
        brought = [with_steps(plan, project(np.asarray(plan.steps), self.cost, budget)) for plan in warm]
        candidates = [plan for plan in (*brought, *cold) if np.any(np.asarray(plan.steps) > 0)]
        wholes = [with_steps(plan, whole(plan)) for plan in brought]
        wholes = [plan for plan in wholes if fits(whole(plan), self.cost, budget)] + cold
        for plan in wholes[: 1 if self.expired() else None]:
            self._evaluate(plan, "start")
        relaxed = []
        if self.expired():
            return candidates[:1]
        for plan in self._spread(candidates, budget, effort.relaxed):
            if self.expired():
                relaxed.append(plan)
                break
            key = f"relax {effort.iterations} {budget!r} {self.cost} {_bytes(plan).hex()}"
            try:
                relaxed.append(_plan(self.remember(key, functools.partial(self._relax, plan, budget, effort))))
            except _CutShort as cut:  # not remembered: a resumed run has more time
                relaxed.append(cut.plan)
            self.report("relax", self._loss(relaxed[-1]))
        relaxed = [plan for plan in relaxed if np.any(np.asarray(plan.steps) > 0)]  # not those that gave up all
        return self._best(relaxed, (len(relaxed) + 1) // 2)

    def _spread(self, plans: Sequence[Plan], budget: float, count: int) -> list[Plan]:
        """The best of those that spend much of the budget and of those that spend little, by turns, much first.

        Before κ is tuned a few steps may look better than many, which have more to gain from it.
        """
        much = [self.cost(np.asarray(plan.steps).tolist()) > 0.4 * budget for plan in plans]
        groups = [self._best([p for p, m in zip(plans, much) if m is wanted], count) for wanted in (True, False)]
        turns = itertools.chain.from_iterable(itertools.zip_longest(*groups))
        return [plan for plan in turns if plan is not None][:count]

    def _best(self, plans: Sequence[Plan], count: int) -> list[Plan]:
        losses = [self._loss(plan) for plan in plans]
        return [plans[i] for i in np.argsort(losses, kind="stable")[:count]]

    def _relax(self, start: Plan, budget: float, effort: Effort) -> list[list[float]]:
        cost, iterations = self.cost, effort.iterations
        plan = relax(self.objective, start, cost, budget, iterations, self.seed, self.expired)
        if self.expired():
            raise _CutShort(plan)
        return _lists(plan)

    def _loss(self, plan: Plan) -> float:
        key = _bytes(plan)
        if key not in self._losses:
            self._losses[key] = self.remember(f"loss {key.hex()}", lambda: self.objective(plan))
        return self._losses[key]

    def _evaluate(self, plan: Plan, phase: str) -> None:
        key = _bytes(plan)
        if key not in self.found:
            self.found[key] = Found(plan, self._loss(plan))
            self.report(phase, self.found[key].loss)

    def _polish(self, plan: Plan, effort: Effort) -> None:
        if self.expired() or effort.polishing == 0:
            return

        def compute() -> Any:
            found = polish(self.objective, plan, effort.polishing)
            return [_lists(found.plan), found.loss]

        lists, loss = self.remember(f"polish {effort.polishing} {_bytes(plan).hex()}", compute)
        polished = _plan(lists)
        self.found[_bytes(polished)] = Found(polished, loss)
        self.report("polish", loss)


def _bytes(plan: Plan) -> bytes:
    return np.concatenate([np.asarray(x, np.float32) for x in jax.tree.leaves(plan)]).tobytes()


def _lists(plan: Plan) -> list[list[float]]:
    return [[float(x) for x in np.asarray(leaf)] for leaf in jax.tree.leaves(plan)]


def _plan(lists: list[list[float]]) -> Plan:
    leaves: list[Array] = [jnp.asarray(values, jnp.float32) for values in lists]
    return Plan(*leaves)
