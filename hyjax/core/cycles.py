"""Step sizes that vary: n explicit steps that cover O(n²) instead of O(n) diffusion time.

One explicit step λ multiplies a wave of the Laplacian's eigenvalue μ ∈ [0, 8] by 1 − λμ, so that n steps multiply
it by p(μ) = ∏ (1 − λ_i μ). Single steps beyond 1/4 amplify the finest waves, but all n together do no harm as long
as |p| ≤ 1 on [0, 8]. Of all such polynomials a shifted Chebyshev polynomial goes furthest in time, Σ λ_i = n²/4;
its relative, fast explicit diffusion, goes a third as far, with |p| that falls off with μ, as diffusion does.

That bounds sums of squares, not values: within and after a cycle a value may lie outside the range of the picture,
which single steps never let happen. Where a quotient is taken, as in `cascade_known`, give cycles a gentle share of
`longest_time`, or known values nearby.

Symbols of this file: λ_i are the n steps of a cycle, t = Σ λ_i its time in squared pixels.

Sources: Grewenig, Weickert and Bruhn, *From box filtering to fast explicit diffusion*, DAGM 2010; Weickert,
Grewenig, Schroers and Bruhn, *Cyclic schemes for PDE-based image analysis*, IJCV 2016.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import ArrayLike, Float

from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

LARGEST_EIGENVALUE = 8.0
"""Largest eigenvalue of −div c ∇ on the 4-neighbourhood with 0 ≤ c ≤ 1."""
STABLE_STEP = 2.0 / LARGEST_EIGENVALUE
"""Step size λ below which a single step is stable."""
MOST_CYCLE_STEPS = 100
"""Most steps of one cycle. Beyond, rounding errors grow too much; repeat shorter ones instead."""
MOST_CYCLES_STEPS = 2048
"""Most steps of a level whose sizes vary, over its several cycles."""
WORST_ERROR = 4.0
"""Bound of the rounding error within a cycle, relative to the picture; a millionth of it is measured."""


def longest_time(n: int) -> float:
    """Longest diffusion time of a stable cycle of n steps: (n² + n) / 12 squared pixels.

    >>> longest_time(8)
    6.0
    """
    return STABLE_STEP * (n * n + n) / 3.0


def shortest_cycle(time: float) -> int:
    """Least number of steps whose cycle covers a diffusion time.

    >>> shortest_cycle(6.0)
    8
    """
    return max(1, math.ceil(math.sqrt(3.0 * time / STABLE_STEP + 0.25) - 0.5 - 1e-9))


@checked_arguments
def step_cycle(n: int, time: float) -> Float[np.ndarray, "n"]:
    """Step sizes of one cycle of fast explicit diffusion, in an order that keeps rounding errors small.

    >>> cycle = step_cycle(4, 1.5)
    >>> len(cycle), round(float(cycle.sum()), 4), bool(cycle.max() > 0.25)
    (4, 1.5, True)

    Args:
        n: steps, 1 to `MOST_CYCLE_STEPS`.
        time: diffusion time of all together, in squared pixels; equals n λ of a run with a constant λ.

    Raises:
        InputError: another number of steps, or a time that n steps cannot cover (see `longest_time`).
    """
    if not 1 <= n <= MOST_CYCLE_STEPS:
        raise InputError(f"cycle: need 1 to {MOST_CYCLE_STEPS} steps, got {n}")
    most = longest_time(n)
    if not 0 < time < math.inf:
        raise InputError(f"cycle: the diffusion time must be finite and > 0, got {time:g}")
    if time > most * (1 + 1e-6):
        needed = shortest_cycle(time)
        instead = f"take at least {needed} steps" if needed <= MOST_CYCLE_STEPS else "repeat shorter cycles"
        raise InputError(
            f"cycle: {n} steps cover a diffusion time of at most {most:.4g} squared pixels, not {time:g}; {instead}"
        )
    i = np.arange(n)
    sizes = time / most * STABLE_STEP / (2.0 * np.cos(np.pi * (2 * i + 1) / (4 * n + 2)) ** 2)
    return sizes[_leja_order(sizes)].astype(np.float32)


def _leja_order(sizes: Float[np.ndarray, "n"]) -> np.ndarray:
    """Order of the steps in which each damps the waves that earlier steps have amplified most.

    The roots 1/λ_i of p, each chosen to make the product of its distances from those before largest.

    Source: Reichel, *Newton interpolation at Leja points*, BIT 1990.
    """
    roots = 1.0 / sizes
    order, distance = [int(np.argmax(roots))], np.zeros(len(roots))
    for _ in range(len(roots) - 1):
        with np.errstate(divide="ignore"):
            distance += np.log(np.abs(roots - roots[order[-1]]))
        order.append(int(np.argmax(distance)))
    return np.array(order)


def growth(step_sizes: Float[ArrayLike, "n"] | Sequence[float]) -> tuple[float, float]:
    """Largest amplification of a wave by steps in this order: (any run of neighbouring steps, all steps).

    The first bounds the growth of a rounding error; the second is at most 1 for a stable cycle.

    >>> [round(factor, 3) for factor in growth(np.full(3, 0.2))]
    [1.0, 1.0]
    """
    sizes = np.asarray(step_sizes, float)
    # The extrema of a Chebyshev polynomial of this degree lie at every eighth of these waves.
    angles = np.linspace(0.0, np.pi, 8 * len(sizes) + 1)
    waves = 0.5 * LARGEST_EIGENVALUE * (1.0 - np.cos(angles))
    worst, running, total = (np.zeros_like(waves) for _ in range(3))
    for size in sizes:
        with np.errstate(divide="ignore"):
            factor = np.maximum(np.log(np.abs(1.0 - size * waves)), -100.0)
        running = np.maximum(running, 0.0) + factor
        worst, total = np.maximum(worst, running), total + factor
    return tuple(float(np.exp(min(x.max(), 100.0))) for x in (worst, total))  # type: ignore[return-value]


def stable_cycle(step_sizes: Float[ArrayLike, "*n"] | Sequence[Any], dtype: DTypeLike = np.float32) -> bool:
    """Whether steps, some beyond 1/4, are stable together, in this order and precision.

    They may be several cycles, one after the other.

    >>> stable_cycle(step_cycle(8, 6.0)), stable_cycle(np.full(8, 0.3))
    (True, False)
    """
    sizes = np.asarray(step_sizes, float)
    if (
        sizes.ndim != 1
        or not 2 <= sizes.size <= MOST_CYCLES_STEPS
        or not (np.isfinite(sizes).all() and (sizes > 0).all())
    ):
        return False
    if np.prod(np.abs(1.0 - LARGEST_EIGENVALUE * sizes)) >= 1.0:
        return False  # a checkerboard would stay for ever
    worst, total = growth(sizes)
    return total <= 1.0 + 1e-4 and worst * float(jnp.finfo(dtype).eps) <= WORST_ERROR
