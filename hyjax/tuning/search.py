"""The best schedule inside a budget: relax, round exactly, polish.

Symbols of this file: n are the steps over the ladder, as in `hyjax.tuning.relaxation`; a *cost* is the latency
table's model of the 95th percentile, in milliseconds; u_l = n_l · step_l / budget is the share of the budget that
the steps of level l take. Shares are what the relaxation steps in: in them one learning rate suits all levels.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxopt.projection import projection_box
from jaxtyping import Array, Float
from scipy.optimize import minimize

from hyjax.schedule import DEFAULT_KAPPA
from hyjax.tuning.budget import Steps, fits, moves, neighbours, project, single_steps
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.relaxation import (
    KAPPA_RANGE,
    LAM_RANGE,
    Plan,
    Prepared,
    evaluate,
    evaluate_with_gradient,
    logit,
)


@dataclasses.dataclass(frozen=True)
class Effort:
    """How long to look.

    Attributes:
        sampled: starting points looked at.
        relaxed: of these, how many are relaxed.
        iterations: of the relaxation, one frame each.
        rounded: integer neighbours of the relaxed optimum that are evaluated.
        polished: how many of these get their κ and λ polished.
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


@dataclasses.dataclass(frozen=True)
class Objective:
    """Mean loss over the tuning frames; what every search method here and in the experiments minimises."""

    prepared: Sequence[Prepared]
    ladder: tuple[int, ...]

    def __call__(self, plan: Plan) -> float:
        return float(np.mean([evaluate(plan, frame, self.ladder) for frame in self.prepared]))

    def gradient(self, plan: Plan, frames: Iterable[int] | None = None) -> tuple[float, Plan]:
        """Mean loss over some of the frames (all by default) and its gradient."""
        chosen = range(len(self.prepared)) if frames is None else list(frames)
        parts = [evaluate_with_gradient(plan, self.prepared[i], self.ladder) for i in chosen]
        return jax.tree.map(lambda *x: np.mean(x, axis=0), *parts)


@dataclasses.dataclass(frozen=True)
class Found:
    """A plan of whole steps with its loss on the tuning frames."""

    plan: Plan
    loss: float

    @property
    def steps(self) -> Steps:
        return whole(self.plan)


def whole(plan: Plan) -> Steps:
    """The plan's steps, rounded."""
    return tuple(int(n) for n in np.round(np.asarray(plan.steps)))


def with_steps(plan: Plan, steps: Sequence[float] | np.ndarray) -> Plan:
    """The plan with other steps. A level that was not there takes κ and λ of the nearest that was."""
    there = np.flatnonzero(np.asarray(plan.steps) > 0)
    if there.size == 0:
        there = np.arange(len(steps))
    nearest = np.array([there[np.argmin(np.abs(there - i))] for i in range(len(steps))])
    return Plan(jnp.asarray(steps, jnp.float32), plan.log_kappa[nearest], plan.logit_lam[nearest])


# ---- relax ----


SPENT = (1.0, 0.5, 0.25, 0.1)
"""Parts of the budget that starting points spend: the best schedule need not be the dearest."""
START_KAPPA = (0.005, 0.2)


def starts(count: int, cost: CostModel, budget: float, seed: int) -> list[Plan]:
    """Whole schedules within the budget to start from: time shared between runs of levels, or at random."""
    size = len(cost.step)
    rng = np.random.default_rng(seed)
    runs = [range(first, last) for first in range(size) for last in range(first + 1, size + 1)]
    runs = [runs[i] for i in rng.permutation(len(runs))]
    per_step = np.maximum(cost.step, 1e-6 * budget)
    plans = [Plan.of(steps) for steps in single_steps(size) if fits(steps, cost, budget)]
    for i in range(count):
        if i % 2 == 0:
            shares = np.isin(np.arange(size), runs[i % len(runs)]).astype(float)
        else:
            shares = rng.dirichlet(np.ones(size)) * (rng.random(size) < 0.6)
        kappa = DEFAULT_KAPPA if i % 4 < 2 else float(np.exp(rng.uniform(*np.log(START_KAPPA))))
        time = shares / max(shares.sum(), 1e-9) * SPENT[i % len(SPENT)] * budget
        steps = tuple(int(n) for n in project(time / per_step, cost, budget))
        if fits(steps, cost, budget):
            plans.append(Plan.of(steps, kappa))
    return plans


RATE = 0.08
_adam = optax.scale_by_adam(b2=0.99)


@jax.jit
def _advance(
    plan: Plan, slope: Plan, state: optax.OptState, unit: Float[Array, "l"], rate: Float[Array, ""]
) -> tuple[Plan, optax.OptState]:
    """One step of Adam in shares of the budget, log κ and logit λ."""
    updates, state = _adam.update(dataclasses.replace(slope, steps=slope.steps * unit), state)
    updates = dataclasses.replace(updates, steps=updates.steps * unit)
    return bounded(jax.tree.map(lambda x, u: x - rate * u, plan, updates)), state


def relax(
    objective: Objective,
    start: Plan,
    cost: CostModel,
    budget: float,
    iterations: int,
    seed: int,
    expired: Callable[[], bool] = lambda: False,
) -> Plan:
    """Projected stochastic descent (Adam) on real-valued steps, log κ and logit λ, one frame an iteration."""
    unit = jnp.asarray(budget / np.maximum(cost.step, 1e-6 * budget), jnp.float32)  # steps in the whole budget
    plan, state = start, _adam.init(start)
    rng = np.random.default_rng(seed)
    order = itertools.chain.from_iterable(rng.permutation(len(objective.prepared)) for _ in itertools.count())
    for i, frame in enumerate(itertools.islice(order, iterations)):
        if expired():
            break
        rate = 0.5 * RATE * (1.0 + np.cos(np.pi * i / iterations))
        plan, state = _advance(plan, objective.gradient(plan, [int(frame)])[1], state, unit, jnp.float32(rate))
        plan = dataclasses.replace(plan, steps=jnp.asarray(project(np.asarray(plan.steps), cost, budget)))
    return plan


def bounded(plan: Plan) -> Plan:
    """κ and λ brought back into their ranges."""
    low, high = bounds()
    return Plan(
        plan.steps,
        projection_box(plan.log_kappa, (low[0], high[0])),
        projection_box(plan.logit_lam, (low[1], high[1])),
    )


def bounds() -> tuple[tuple[float, float], tuple[float, float]]:
    """Lowest and highest (log κ, logit 4 λ)."""
    kappa, lam = np.log(KAPPA_RANGE), [logit(4.0 * x) for x in LAM_RANGE]
    return (float(kappa[0]), lam[0]), (float(kappa[1]), lam[1])


# ---- round ----


def promising(candidates: Sequence[Steps], plan: Plan, slope: Plan, count: int) -> list[Steps]:
    """The candidates with the lowest loss to first order around the relaxed plan."""
    real, gradient = np.asarray(plan.steps, float), np.asarray(slope.steps, float)
    return sorted(candidates, key=lambda steps: (float((np.array(steps) - real) @ gradient), steps))[:count]


# ---- polish ----


def polish(objective: Objective, plan: Plan, iterations: int) -> Found:
    """κ and λ of the levels that are there, by bounded quasi-Newton steps on all frames, the step counts fixed.

    Source: Byrd, Lu, Nocedal and Zhu, *A limited memory algorithm for bound constrained optimization*, 1995.
    """
    there = np.flatnonzero(np.asarray(plan.steps) > 0)
    best = Found(plan, objective(plan))

    def placed(x: np.ndarray) -> Plan:
        kappa, lam = np.split(x.astype(np.float32), 2)
        return Plan(plan.steps, plan.log_kappa.at[there].set(kappa), plan.logit_lam.at[there].set(lam))

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal best
        candidate = placed(x)
        value, slope = objective.gradient(candidate)
        if value < best.loss:
            best = Found(candidate, float(value))
        gradient = np.concatenate([np.asarray(slope.log_kappa)[there], np.asarray(slope.logit_lam)[there]])
        return SCALE * float(value), SCALE * gradient.astype(float)

    low, high = bounds()
    box = [(low[k], high[k]) for k in (0, 1) for _ in there]
    first = np.concatenate([np.asarray(plan.log_kappa)[there], np.asarray(plan.logit_lam)[there]]).astype(float)
    # float32 losses are smooth to about seven digits: SciPy's own stopping rule would chase the noise.
    options = {"maxiter": iterations, "maxfun": iterations + 4, "ftol": 1e-5}
    minimize(loss, np.clip(first, *np.array(box).T), jac=True, method="L-BFGS-B", bounds=box, options=options)
    return best


SCALE = 100.0
"""Losses are around 0.01, where L-BFGS-B's first step, of the gradient's length, would be short."""


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
        """All that was evaluated and fits, best first, the best κ and λ of each step counts only."""
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
