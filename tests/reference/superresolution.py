"""Guided super-resolution as float64 loops, from the steps of `reference.paper`."""

import math

import numpy as np

from reference import paper


def adjust(y: np.ndarray, source: np.ndarray, known: np.ndarray, factor: int) -> np.ndarray:
    """Every pixel times the ratio of the source to the mean of its cell, where that is known."""
    result = np.array(y, np.float64)
    means = paper.downsample(y, factor)
    for i, j in np.ndindex(result.shape[:2]):
        a, b = i // factor, j // factor
        if known[a, b]:
            result[i, j] *= source[a, b] / (means[a, b] + 1e-8)
    return result


def super_resolve(
    source: np.ndarray,
    known: np.ndarray,
    guide: np.ndarray,
    levels: list[tuple[int, np.ndarray, float]],
    factor: int,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """`levels` are (factor, step sizes, κ), coarse to fine."""
    full = guide.shape[:2]

    def shape_at(level: int) -> tuple[int, int]:
        return math.ceil(full[0] / level), math.ceil(full[1] / level)

    before = levels[0][0]
    if start is not None:
        y = paper.downsample(start, before)
    elif before >= factor:
        y = paper.downsample(source, before // factor)
    else:
        y = paper.upsample(source, factor // before, shape_at(before))
    for level, step_sizes, kappa in levels:
        if level != before:
            y = paper.upsample(y, before // level, shape_at(level))
        edges = paper.min_pool(paper.conductance(guide, kappa), level)
        for lam in step_sizes:
            y = paper.diffuse_step(y, edges, float(lam))
            if level < factor:
                y = adjust(y, source, known, factor // level)
        before = level
    return adjust(paper.upsample(y, before, full), source, known, factor)
