"""Whole and real step counts inside a budget: projection, neighbours, filling up.

Symbols of this file: n are the steps over the ladder, coarse to fine; a *cost* is the latency table's model of a
schedule, in milliseconds.
"""

import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxopt.projection import projection_box_section
from jaxtyping import Float

from hyjax.tuning.cost_model import CostModel

MOST_STEPS = 64
"""Of one level. Twice as far is reached at a quarter of the cost one level coarser."""

Steps = tuple[int, ...]

_project_section = jax.jit(projection_box_section)  # its bisection compiles anew in every call otherwise


def project(steps: Float[np.ndarray, "l"], cost: CostModel, budget: float) -> Float[np.ndarray, "l"]:
    """The nearest step counts (in shares of the budget) whose cost fits.

    A level with less than half a step is dropped, with all it costs; levels are dropped, cheapest first, until the
    rest fits at all.

    Returns:
        0 ≤ n ≤ `MOST_STEPS`; all zero if no single level fits the budget.
    """
    steps = np.where(steps < 0.5, 0.0, np.minimum(steps, MOST_STEPS)).astype(np.float32)
    per_step = np.maximum(cost.step, 1e-6 * budget)
    while steps.any():
        present = steps > 0
        if cost(steps.tolist()) <= budget:
            return steps
        finest = int(np.flatnonzero(present)[-1])
        left = budget - cost.fixed - float(np.sum(np.array(cost.level)[present])) - cost.finest[finest]
        low, high = np.where(present, 0.5, 0.0) * per_step / budget, present * MOST_STEPS * per_step / budget
        if left / budget >= low.sum():
            shares = _project_section(
                jnp.asarray(steps * per_step / budget), (low, high, np.ones_like(low), left / budget)
            )
            projected = np.asarray(shares) * budget / per_step
            projected = np.where(present, np.clip(projected, 0.5, MOST_STEPS), 0.0)
            if not (present & (projected <= 0.5)).any():
                return projected.astype(np.float32)
            steps = np.where(projected <= 0.5, 0.0, projected)  # with its fixed cost the others may do more
        else:
            weakest = np.argmin(np.where(present, steps * per_step, np.inf))
            steps = np.where(np.arange(len(steps)) == weakest, 0.0, steps)
    return steps


def fits(steps: Sequence[int], cost: CostModel, budget: float) -> bool:
    """Whether a schedule of these steps has any and costs no more than the budget."""
    return any(steps) and max(steps) <= MOST_STEPS and cost(steps) <= budget


def single_steps(size: int) -> list[Steps]:
    """One step at each level of the ladder alone: the cheapest schedules."""
    return [tuple(int(i == k) for i in range(size)) for k in range(size)]


def fill(steps: Steps, cost: CostModel, budget: float, order: Sequence[int]) -> Steps:
    """Spend what is left of the budget: more steps for the levels that have some, in this order."""
    filled = list(steps)
    for level in order:
        while filled[level] and fits([*filled[:level], filled[level] + 1, *filled[level + 1 :]], cost, budget):
            filled[level] += 1
    return tuple(filled)


def neighbours(real: Float[np.ndarray, "l"], cost: CostModel, budget: float) -> list[Steps]:
    """All whole step counts around these real ones that fit and leave no room for one more step within reach.

    The table makes this a small knapsack, so it is listed completely: each level at up to two below and above.
    """
    choices = []
    for n in real:
        low, high = int(np.floor(n)), int(np.ceil(n))
        around = {low - 1, low, high, high + 1} if n > 0 else {0}
        choices.append(sorted({int(np.clip(k, 0, MOST_STEPS)) for k in around}))
    listed = [steps for steps in itertools.product(*choices) if fits(steps, cost, budget)]
    there = set(listed)

    def can_grow(steps: Steps) -> bool:
        return any(n and (*steps[:level], n + 1, *steps[level + 1 :]) in there for level, n in enumerate(steps))

    return [steps for steps in listed if not can_grow(steps)]


def moves(steps: Steps, cost: CostModel, budget: float) -> list[Steps]:
    """Neighbours of a schedule that fit: steps more or fewer at one level, another one paying or filled up."""
    size = len(steps)
    found: dict[Steps, None] = {}
    for level in range(size):
        n = steps[level]
        for target in {n + 1, n + 2, n + max(3, n // 2), n - 1, n - 2, n // 2, 0}:
            if target == n or not 0 <= target <= MOST_STEPS:
                continue
            changed = (*steps[:level], target, *steps[level + 1 :])
            others = [k for k in range(size) if k != level]
            if fits(changed, cost, budget):
                found[changed] = None
                for other in others:
                    found[fill(changed, cost, budget, [other])] = None
            for other in others:
                paid = list(changed)
                while paid[other] and not fits(paid, cost, budget):
                    paid[other] -= 1
                if fits(paid, cost, budget):
                    found[tuple(paid)] = None
    found.pop(steps, None)
    return list(found)
