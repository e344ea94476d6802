"""The continuous part of the search: starting points, relaxed projected descent, polishing of κ, λ and α.

Symbols of this file: n are the steps at each factor, as in `hyjax.tuning.relaxation`; a *cost* is the latency
table's model of the 95th percentile, in milliseconds; u_l = n_l · step_l / budget is the share of the budget that
the steps of level l take. Shares are what the relaxation steps in: in them one learning rate suits all levels.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxopt.projection import projection_box
from jaxtyping import Array, Float
from scipy.optimize import minimize

from hyjax.core.schedule import GUIDED_KAPPA
from hyjax.tuning.budget import Steps, fits, project, single_steps
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.relaxation import (
    FIDELITY_RANGE,
    KAPPA_RANGE,
    LAM_RANGE,
    Prepared,
    RelaxedSchedule,
    evaluate,
    evaluate_with_gradient,
    logit,
)


@dataclasses.dataclass(frozen=True)
class Objective:
    """Mean loss over the tuning frames, the objective of every search method."""

    prepared: Sequence[Prepared]
    factors: tuple[int, ...]

    def __call__(self, point: RelaxedSchedule) -> float:
        return float(np.mean([evaluate(point, frame, self.factors) for frame in self.prepared]))

    def gradient(
        self, point: RelaxedSchedule, frames: Iterable[int] | None = None
    ) -> tuple[float, RelaxedSchedule]:
        """Mean loss over some of the frames (all by default) and its gradient."""
        chosen = range(len(self.prepared)) if frames is None else frames
        return jax.tree.map(lambda *x: np.mean(x, axis=0), *(self.part(point, i) for i in chosen))

    def part(self, point: RelaxedSchedule, frame: int) -> tuple[Array, RelaxedSchedule]:
        """Loss of one frame and its gradient."""
        return evaluate_with_gradient(point, self.prepared[frame], self.factors)


@dataclasses.dataclass(frozen=True)
class Found:
    """A point of whole steps with its loss on the tuning frames."""

    point: RelaxedSchedule
    loss: float


def whole(point: RelaxedSchedule) -> Steps:
    """The point's steps, rounded."""
    return tuple(int(n) for n in np.round(np.asarray(point.steps)))


def with_steps(point: RelaxedSchedule, steps: Sequence[float] | np.ndarray) -> RelaxedSchedule:
    """The point with other steps. A level that was not there takes κ, λ and α of the nearest that was."""
    there = np.flatnonzero(np.asarray(point.steps) > 0)
    if there.size == 0:
        there = np.arange(len(steps))
    nearest = np.array([there[np.argmin(np.abs(there - i))] for i in range(len(steps))])
    return RelaxedSchedule(jnp.asarray(steps, jnp.float32), *(part[nearest] for part in _continuous(point)))


BUDGET_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Parts of the budget that starting points spend: the best schedule need not be the dearest."""
START_KAPPA = (0.005, 0.2)


def starts(count: int, cost: CostModel, budget: float, seed: int) -> list[RelaxedSchedule]:
    """Whole schedules within the budget to start from: time shared between runs of levels, or at random."""
    size = len(cost.step)
    rng = np.random.default_rng(seed)
    runs = [range(first, last) for first in range(size) for last in range(first + 1, size + 1)]
    runs = [runs[i] for i in rng.permutation(len(runs))]
    per_step = np.maximum(cost.step, 1e-6 * budget)
    points = [RelaxedSchedule.of(steps) for steps in single_steps(size) if fits(steps, cost, budget)]
    for i in range(count):
        if i % 2 == 0:
            shares = np.isin(np.arange(size), runs[i % len(runs)]).astype(float)
        else:
            shares = rng.dirichlet(np.ones(size)) * (rng.random(size) < 0.6)
        kappa = GUIDED_KAPPA if i % 4 < 2 else float(np.exp(rng.uniform(*np.log(START_KAPPA))))
        time = shares / max(shares.sum(), 1e-9) * BUDGET_SHARES[i % len(BUDGET_SHARES)] * budget
        steps = tuple(int(n) for n in project(time / per_step, cost, budget))
        if fits(steps, cost, budget):
            points.append(RelaxedSchedule.of(steps, kappa))
    return points


LEARNING_RATE = 0.08
_adam = optax.scale_by_adam(b2=0.99)


@jax.jit
def _advance(
    point: RelaxedSchedule,
    slope: RelaxedSchedule,
    state: optax.OptState,
    unit: Float[Array, "l"],
    rate: Float[Array, ""],
) -> tuple[RelaxedSchedule, optax.OptState]:
    """One step of Adam in shares of the budget, log κ, logit λ and log α."""
    updates, state = _adam.update(dataclasses.replace(slope, steps=slope.steps * unit), state)
    updates = dataclasses.replace(updates, steps=updates.steps * unit)
    return bounded(jax.tree.map(lambda x, u: x - rate * u, point, updates)), state


def relax(
    objective: Objective,
    start: RelaxedSchedule,
    cost: CostModel,
    budget: float,
    iterations: int,
    seed: int,
    expired: Callable[[], bool] = lambda: False,
) -> RelaxedSchedule:
    """Projected stochastic descent (Adam) on real-valued steps, log κ, logit λ and log α, one frame each."""
    unit = jnp.asarray(budget / np.maximum(cost.step, 1e-6 * budget), jnp.float32)  # steps in the whole budget
    point, state = start, _adam.init(start)
    rng = np.random.default_rng(seed)
    order = itertools.chain.from_iterable(rng.permutation(len(objective.prepared)) for _ in itertools.count())
    for i, frame in enumerate(itertools.islice(order, iterations)):
        if expired():
            break
        rate = 0.5 * LEARNING_RATE * (1.0 + np.cos(np.pi * i / iterations))
        point, state = _advance(point, objective.gradient(point, [int(frame)])[1], state, unit, jnp.float32(rate))
        point = dataclasses.replace(point, steps=jnp.asarray(project(np.asarray(point.steps), cost, budget)))
    return point


def bounded(point: RelaxedSchedule) -> RelaxedSchedule:
    """κ, λ and α projected back into their ranges."""
    values = (point.log_kappa, point.logit_lam, point.log_fidelity)
    return RelaxedSchedule(point.steps, *(projection_box(value, box) for value, box in zip(values, bounds())))


def bounds() -> list[tuple[float, float]]:
    """Ranges of log κ, logit 4 λ and log α."""
    lam = tuple(logit(4.0 * x) for x in LAM_RANGE)
    kappa, fidelity = (tuple(float(x) for x in np.log(values)) for values in (KAPPA_RANGE, FIDELITY_RANGE))
    return [kappa, lam, fidelity]  # type: ignore[list-item]


def promising(
    candidates: Sequence[Steps], point: RelaxedSchedule, slope: RelaxedSchedule, count: int
) -> list[Steps]:
    """The candidates with the lowest loss to first order around the relaxed point."""
    real, gradient = np.asarray(point.steps, float), np.asarray(slope.steps, float)
    return sorted(candidates, key=lambda steps: (float((np.array(steps) - real) @ gradient), steps))[:count]


def polish(
    objective: Objective, point: RelaxedSchedule, iterations: int, expired: Callable[[], bool] = lambda: False
) -> Found:
    """κ, λ and α of the levels that are there, by bounded quasi-Newton steps on all frames, the step counts fixed.

    The best so far where the time has expired.

    Source: Byrd, Lu, Nocedal and Zhu, *A limited memory algorithm for bound constrained optimization*, 1995.
    """
    there = np.flatnonzero(np.asarray(point.steps) > 0)
    best = Found(point, objective(point))

    def placed(x: np.ndarray) -> RelaxedSchedule:
        values = zip(_continuous(point), np.split(x.astype(np.float32), 3))
        return RelaxedSchedule(point.steps, *(old.at[there].set(new) for old, new in values))

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal best
        candidate = placed(x)
        value, slope = objective.gradient(candidate)
        if value < best.loss:
            best = Found(candidate, float(value))
        gradient = np.concatenate([np.asarray(part)[there] for part in _continuous(slope)])
        return LOSS_SCALE * float(value), LOSS_SCALE * gradient.astype(float)

    def go_on(_: object) -> None:
        if expired():
            raise StopIteration  # which SciPy takes for the end

    box = [bound for bound in bounds() for _ in there]
    first = np.concatenate([np.asarray(part)[there] for part in _continuous(point)]).astype(float)
    # float32 losses are smooth to about seven digits: SciPy's own stopping rule would chase the noise.
    options = {"maxiter": iterations, "maxfun": iterations + 4, "ftol": 1e-5}
    begun = np.clip(first, *np.array(box).T)
    if not expired():
        minimize(loss, begun, jac=True, method="L-BFGS-B", bounds=box, callback=go_on, options=options)
    return best


def _continuous(point: RelaxedSchedule) -> tuple[Array, ...]:
    return point.log_kappa, point.logit_lam, point.log_fidelity


LOSS_SCALE = 100.0
"""Losses are around 0.01, where L-BFGS-B's first step, of the gradient's length, would be short."""
