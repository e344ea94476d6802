"""Whole and real step counts inside a budget: projection, neighbours, filling up.

Symbols of this file: n are the steps at each factor, coarse to fine; a *cost* is the latency table's model of a
schedule, in milliseconds.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hyjax.tuning.cost_model import CostModel

MOST_STEPS = 64
"""Most steps of one level. Twice as far is reached at a quarter of the cost one level coarser."""

Steps = tuple[int, ...]


def project(steps: Float[np.ndarray, "l"], cost: CostModel, budget: float) -> Float[np.ndarray, "l"]:
    """Step counts projected within the budget: every level gives up the same part of the time its steps take.

    That is the nearest point in relative entropy of the times spent, the projection of mirror descent. The
    Euclidean one would take as much from a cheap coarse level as from a dear fine one, and so wipe it out. A level
    left with less than half a step is dropped, the smallest first, and what it cost goes back to the others.

    Returns:
        0 ≤ n ≤ `MOST_STEPS`, all 0 if not even half a step of a single level fits.

    Source: Beck and Teboulle, *Mirror descent and nonlinear projected subgradient methods*, 2003.
    """
    steps = np.where(steps < 0.5, 0.0, np.minimum(steps, MOST_STEPS))
    while steps.any():
        if cost(steps.tolist()) <= budget:
            return steps.astype(np.float32)
        present = steps > 0
        spent = float(steps @ np.asarray(cost.step))
        left = budget - (cost(steps.tolist()) - spent)
        scaled = steps * max(left, 0.0) / max(spent, 1e-9) * (1.0 - 1e-6)
        if scaled[present].min() >= 0.5:
            return scaled.astype(np.float32)
        steps = np.where(np.arange(len(steps)) == np.argmin(np.where(present, steps, np.inf)), 0.0, steps)
    return steps.astype(np.float32)


def fits(steps: Sequence[int], cost: CostModel, budget: float) -> bool:
    """Whether a schedule of these steps has any and costs no more than the budget."""
    return any(steps) and max(steps) <= MOST_STEPS and cost(steps) <= budget


def single_steps(size: int) -> list[Steps]:
    """One step at each level alone: the cheapest schedules."""
    return [tuple(int(i == k) for i in range(size)) for k in range(size)]


def swap(steps: Steps, level: int, count: int) -> Steps:
    """The steps with another count at one level."""
    return (*steps[:level], count, *steps[level + 1 :])


def fill(steps: Steps, cost: CostModel, budget: float, order: Sequence[int]) -> Steps:
    """Spend the rest of the budget: more steps for the levels that have some, in this order."""
    for level in order:
        while steps[level] and fits(more := swap(steps, level, steps[level] + 1), cost, budget):
            steps = more
    return steps


def neighbours(real: Float[np.ndarray, "l"], cost: CostModel, budget: float) -> list[Steps]:
    """All whole step counts around these real ones that fit, each level at up to two below and above."""
    choices = []
    for n in real:
        low, high = int(np.floor(n)), int(np.ceil(n))
        around = {low - 1, low, high, high + 1} if n > 0 else {0}
        choices.append(sorted({int(np.clip(k, 0, MOST_STEPS)) for k in around}))
    return [steps for steps in itertools.product(*choices) if fits(steps, cost, budget)]


def moves(steps: Steps, cost: CostModel, budget: float) -> list[Steps]:
    """Neighbours of a schedule that fit: steps more or fewer at one level, another one paying or filled up."""
    size = len(steps)
    found: dict[Steps, None] = {}
    for level in range(size):
        n = steps[level]
        for target in {n + 1, n + 2, n + max(3, n // 2), n - 1, n - 2, n // 2, 0}:
            if target == n or not 0 <= target <= MOST_STEPS:
                continue
            changed = swap(steps, level, target)
            others = [k for k in range(size) if k != level]
            if fits(changed, cost, budget):
                found[changed] = None
                for other in others:
                    found[fill(changed, cost, budget, [other])] = None
            if target == n + 1:  # in exchange for much of another level, though there was room
                for other in others:
                    for less in {1, steps[other] // 2} - {steps[other]}:
                        if less < steps[other] and fits(swap(changed, other, less), cost, budget):
                            found[swap(changed, other, less)] = None
            for other in others:
                paid = list(changed)
                while paid[other] and not fits(paid, cost, budget):
                    paid[other] -= 1
                if fits(paid, cost, budget):
                    found[tuple(paid)] = None
    found.pop(steps, None)
    return list(found)
