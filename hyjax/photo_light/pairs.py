"""Pairs of vertices on one plane, whose albedo is likely the same: what the fit of the photo's light looks at."""

import numpy as np
from jaxtyping import Bool, Float, Int

NEAREST, FARTHEST = 0.1, 1.5
"""Metres between the two: short pairs tell little of light that changes slowly."""
PLANE = 0.05
"""Metres off each other's plane."""
COPLANAR = 0.93
"""Least cosine between their normals."""
ASTRAY = 0.08
"""Metres between where a partner was looked for and where it was found."""
BLOCK = 0.9
"""Metres a side of the blocks that are held out whole."""


def coplanar_pairs(
    position: Float[np.ndarray, "v 3"],
    normal: Float[np.ndarray, "v 3"],
    usable: Bool[np.ndarray, "v"],
    count: int,
    seed: int = 0,
) -> Int[np.ndarray, "n 2"]:
    """Random pairs of usable vertices on one plane; fewer than `count` if there are not as many."""
    rng, candidates = np.random.default_rng(seed), np.flatnonzero(usable)
    if len(candidates) < 2:
        return np.zeros((0, 2), int)
    first = rng.choice(candidates, 3 * count)
    n = normal[first]
    away = rng.normal(size=n.shape)
    away -= np.einsum("nk,nk->n", away, n)[:, None] * n
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    target = position[first] + away * rng.uniform(NEAREST, FARTHEST, len(n))[:, None]
    from scipy.spatial import cKDTree  # SciPy is slow to load

    astray, nearest = cKDTree(position[candidates]).query(target)
    second = candidates[nearest]
    off = np.abs(np.einsum("nk,nk->n", position[second] - position[first], n))
    alike = np.einsum("nk,nk->n", normal[second], n) > COPLANAR
    kept = (astray < ASTRAY) & (off < PLANE) & alike & (first != second)
    return np.stack([first[kept], second[kept]], axis=1)[:count]


def held_out(position: Float[np.ndarray, "n 3"], seed: int = 0) -> Bool[np.ndarray, "n"]:
    """Whether points lie in blocks of space that are held out: a random third of all."""
    cell = np.floor(position / BLOCK).astype(np.int64)
    rng = np.random.default_rng(seed)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    return (rng.random(number.max(initial=0) + 1) < 1 / 3)[number.reshape(-1)]
