"""Belief in an estimate of the photo's light: how much flatter it makes planes that its fit has not seen."""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.photo_light.fit import RADIANCE_FLOOR, FitProblem, fit_sources, illuminance

FOLD_COUNT = 3
"""Number of parts of the scan; each judges a fit on the others."""
FOLD_ITERATIONS = 60
"""Most iterations of a fit that only judges: its last ones change the flatness little."""
EXPONENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Candidate exponents of E_old."""
LEAST_GAIN = 0.04
"""Least relative gain in flatness of planes on held-out pairs; below it nothing is divided out."""
LEAST_ERRORS = 2.0
"""Least ratio of this gain to its standard error."""
ERROR_SIDE = 0.3
"""Side, in metres, of the blocks of space whose pairs tell the standard error."""
LEAST_PAIRS = 100
"""Fewest pairs of vertices in a fold; with fewer there is no estimate of the light."""
LARGEST_SIDE, SMALLEST_SIDE = 0.9, 0.15
"""Largest and smallest side, in metres, of a fold's blocks of space; halved until no fold is too small."""
LEAST_SHARE = 0.2
"""Least share of the pairs in each fold."""


@dataclasses.dataclass(frozen=True)
class Belief:
    """Belief in an estimate, brightness and hue apart.

    Attributes:
        exponent: of the brightness of E_old: 0 where dividing would do harm, 1 where it is believed.
        hue_exponent: of the hue of E_old, which is harder to separate from that of the surfaces.
        flatness: mean difference of log brightness on planes after the division over that before it, on pairs that
            were held out, for each of `EXPONENTS`.
    """

    exponent: float
    hue_exponent: float
    flatness: tuple[float, ...]


NO_BELIEF = Belief(0.0, 0.0, (1.0,) * len(EXPONENTS))
"""Belief where scan and frames give too little evidence: nothing is divided out."""


def folds(position: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "n"]:
    """Fold of each point: whole blocks of space, as large as leaves every fold enough of them."""
    rng, side = np.random.default_rng(0), LARGEST_SIDE
    while True:
        block = blocks(position, side)
        sizes = np.bincount(block, minlength=1)
        fold, total = np.zeros(len(sizes), int), np.zeros(FOLD_COUNT)
        for number in np.argsort(rng.random(len(sizes)) - sizes):
            fold[number] = np.argmin(total)
            total[fold[number]] += sizes[number]
        if total.min() >= LEAST_SHARE * total.sum() or side / 2 < SMALLEST_SIDE:
            return fold[block]
        side /= 2


def fit_and_judge(
    problem: Callable[[Bool[np.ndarray, "n"]], FitProblem],
    pairs: Int[np.ndarray, "n 2"],
    position: Float[np.ndarray, "v 3"],
) -> "tuple[Float[np.ndarray, 'k 3'], Belief, Float[np.ndarray, 'n e']] | None":
    """Strengths of the sources fitted to all pairs, and the belief from fits that leave one fold out each.

    Args:
        problem: fit to the chosen ones of the pairs.

    Returns:
        Strengths, belief, and for each pair the difference of log brightness that is left after the division by E
        to each of `EXPONENTS`, from the fit that left it out; None where there are too few pairs.
    """
    fold = folds(position[pairs[:, 0]]) if len(pairs) else np.zeros(0, int)
    counts = np.bincount(fold, minlength=FOLD_COUNT)
    if counts.min() < LEAST_PAIRS:
        return None
    bright, hue = np.zeros((2, len(pairs), len(EXPONENTS)))
    pool = ThreadPoolExecutor(1, thread_name_prefix="fit")
    whole = pool.submit(fit_sources, problem(np.ones(len(pairs), bool)))  # beside those that judge
    pool.shutdown(wait=False)
    for number in range(FOLD_COUNT):
        part = problem(fold != number)
        theta = jnp.asarray(fit_sources(part, FOLD_ITERATIONS), jnp.float32)
        light = np.log(np.asarray(illuminance(part, theta)).T + RADIANCE_FLOOR)
        logs = zip(split(np.asarray(part.log_radiance).T), split(light))
        for left, (radiance, e) in zip((bright, hue), logs):
            left[fold == number] = differences(radiance, e, pairs[fold == number]).mean(axis=2)
    block = blocks(position[pairs[:, 0]], ERROR_SIDE)
    found, covariance = flatness(bright, block)
    belief = Belief(best(found, covariance), best(*flatness(hue, block)), tuple(float(x) for x in found))
    return whole.result().T, belief, bright


def blocks(position: Float[np.ndarray, "n 3"], side: float) -> Int[np.ndarray, "n"]:
    """Number of the block of space that each point is in."""
    _, block = np.unique(np.floor(position / side).astype(np.int64), axis=0, return_inverse=True)
    return block.reshape(-1)


def split(log: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "v 1"], Float[np.ndarray, "v 3"]]:
    """Split logarithms into brightness and hue."""
    mean = log.mean(axis=1, keepdims=True)
    return mean, log - mean


def differences(
    log_radiance: Float[np.ndarray, "v c"], log_light: Float[np.ndarray, "v c"], pairs: Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n e c"]:
    """Absolute differences across pairs after dividing by E to each exponent."""
    c, e = (v[pairs[:, 0]] - v[pairs[:, 1]] for v in (log_radiance, log_light))
    return np.abs(c[:, None] - np.array(EXPONENTS)[:, None] * e[:, None])


def flatness(
    left: Float[np.ndarray, "n e"], block: Int[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "e"], Float[np.ndarray, "e e"]]:
    """Mean difference after dividing by E to each exponent over the one before, and the covariance of its errors.

    Pairs of one block are alike, so errors are by leaving out one block at a time (jackknife). Source: Efron and
    Stein, "The jackknife estimate of variance", 1981.
    """
    sums = np.stack([np.bincount(block, column) for column in left.T], axis=1)
    total, count = sums.sum(axis=0), len(sums)
    found = total / max(total[0], 1e-9)
    if count < 2:
        return found, np.full((len(found),) * 2, np.inf)
    others = total - sums
    others = others / np.maximum(others[:, :1], 1e-9)
    return found, (count - 1) * np.cov(others, rowvar=False, bias=True)


def best(found: Float[np.ndarray, "e"], covariance: Float[np.ndarray, "e e"]) -> float:
    """Exponent that flattens most; 0 where it gains too little, or as much as few pairs may by chance.

    Of exponents that gain enough, and as much to within a standard error, it is the smallest: it does least harm.
    Source: Breiman et al., *Classification and Regression Trees*, 1984 (the one-standard-error rule).
    """
    number, variance = int(np.argmin(found)), np.diagonal(covariance)
    enough = 1 - found > np.maximum(LEAST_GAIN, LEAST_ERRORS * variance**0.5)
    if not enough[number]:
        return 0.0
    apart = np.maximum(variance + variance[number] - 2 * covariance[number], 0.0) ** 0.5
    return EXPONENTS[int(np.argmax(enough & (found - found[number] <= apart)))]
