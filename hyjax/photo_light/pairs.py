"""Pairs of vertices on one plane, whose albedo is likely the same: data of the fit of the photo's light."""

import numpy as np
from jaxtyping import Bool, Float, Int

LEAST_DISTANCE, LARGEST_DISTANCE = 0.1, 1.5
"""Distances between the vertices of a pair, in metres: short pairs carry little about slowly varying light."""
PLANE_DISTANCE = 0.05
"""Largest distance, in metres, from each other's plane."""
COPLANAR_COSINE = 0.93
"""Least cosine between the normals of a pair."""
PARTNER_DISTANCE = 0.08
"""Largest distance, in metres, between a partner's expected and actual place."""


def coplanar_pairs(
    position: Float[np.ndarray, "v 3"],
    normal: Float[np.ndarray, "v 3"],
    usable: Bool[np.ndarray, "v"],
    count: int,
) -> Int[np.ndarray, "n 2"]:
    """Random pairs of usable vertices on one plane; fewer than `count` if there are not as many."""
    rng, candidates = np.random.default_rng(0), np.flatnonzero(usable)
    if len(candidates) < 2:
        return np.zeros((0, 2), int)
    first = rng.choice(candidates, 3 * count)
    n = normal[first]
    away = rng.normal(size=n.shape)
    away -= np.einsum("nk,nk->n", away, n)[:, None] * n
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    target = position[first] + away * rng.uniform(LEAST_DISTANCE, LARGEST_DISTANCE, len(n))[:, None]
    from scipy.spatial import cKDTree  # SciPy is slow to load

    astray, nearest = cKDTree(position[candidates]).query(target)
    second = candidates[nearest]
    off = np.abs(np.einsum("nk,nk->n", position[second] - position[first], n))
    alike = np.einsum("nk,nk->n", normal[second], n) > COPLANAR_COSINE
    kept = (astray < PARTNER_DISTANCE) & (off < PLANE_DISTANCE) & alike & (first != second)
    return np.stack([first[kept], second[kept]], axis=1)[:count]
