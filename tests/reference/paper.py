"""The paper's equations, letter by letter, as float64 loops. Slow on purpose; shares no code with the package.

Pictures are H×W×C. An edge field is a pair: vertical[i, j] joins pixel (i, j) to (i+1, j), horizontal[i, j] joins
(i, j) to (i, j+1).
"""

import math

import numpy as np

Edges = tuple[np.ndarray, np.ndarray]


def conductance(guide: np.ndarray, kappa: float, norm: str = "l2") -> Edges:
    """Eq. 3: κ² / (κ² + ‖g^p − g^n‖²)."""
    g = np.asarray(guide, np.float64)
    h, w, channels = g.shape

    def c(p: np.ndarray, n: np.ndarray) -> float:
        if norm == "l2":
            squared = sum((p[k] - n[k]) ** 2 for k in range(channels))
        else:
            squared = (sum(abs(p[k] - n[k]) for k in range(channels)) / channels) ** 2
        return kappa**2 / (kappa**2 + squared)

    vertical, horizontal = np.empty((h - 1, w)), np.empty((h, w - 1))
    for i in range(h):
        for j in range(w):
            if i + 1 < h:
                vertical[i, j] = c(g[i, j], g[i + 1, j])
            if j + 1 < w:
                horizontal[i, j] = c(g[i, j], g[i, j + 1])
    return vertical, horizontal


def diffuse_step(y: np.ndarray, edges: Edges, lam: float) -> np.ndarray:
    """Eq. 2: y^p + λ Σ over the neighbours n inside the picture of (y^n − y^p) c(g^p, g^n)."""
    y = np.asarray(y, np.float64)
    vertical, horizontal = edges
    h, w, _ = y.shape
    result = y.copy()
    for i in range(h):
        for j in range(w):
            if i > 0:
                result[i, j] += lam * (y[i - 1, j] - y[i, j]) * vertical[i - 1, j]
            if i < h - 1:
                result[i, j] += lam * (y[i + 1, j] - y[i, j]) * vertical[i, j]
            if j > 0:
                result[i, j] += lam * (y[i, j - 1] - y[i, j]) * horizontal[i, j - 1]
            if j < w - 1:
                result[i, j] += lam * (y[i, j + 1] - y[i, j]) * horizontal[i, j]
    return result


def diffuse(y: np.ndarray, edges: Edges, step_sizes: np.ndarray) -> np.ndarray:
    """The operator D of Eq. 4."""
    y = np.asarray(y, np.float64)
    for lam in step_sizes:
        y = diffuse_step(y, edges, float(lam))
    return y


def downsample(y: np.ndarray, factor: int) -> np.ndarray:
    """Mean of the pixels of each factor × factor cell; cells at the lower and right border may be cut off."""
    y = np.asarray(y, np.float64)
    h, w, channels = y.shape
    result = np.empty((math.ceil(h / factor), math.ceil(w / factor), channels))
    for i in range(result.shape[0]):
        for j in range(result.shape[1]):
            pixels = [
                y[a, b]
                for a in range(i * factor, min((i + 1) * factor, h))
                for b in range(j * factor, min((j + 1) * factor, w))
            ]
            result[i, j] = sum(pixels) / len(pixels)
    return result


def upsample(y: np.ndarray, factor: int, shape: tuple[int, int]) -> np.ndarray:
    """Bilinear interpolation between cell centres, constant beyond the outermost of them."""
    y = np.asarray(y, np.float64)
    result = np.empty((*shape, y.shape[2]))

    def neighbours(pixel: int, cells: int) -> tuple[int, int, float]:
        place = (pixel + 0.5) / factor - 0.5  # in cells: the centre of cell k is at k
        place = min(max(place, 0.0), cells - 1.0)
        low = min(int(place), cells - 1)
        return low, min(low + 1, cells - 1), place - low

    for i in range(shape[0]):
        top, bottom, s = neighbours(i, y.shape[0])
        for j in range(shape[1]):
            left, right, t = neighbours(j, y.shape[1])
            upper = (1 - t) * y[top, left] + t * y[top, right]
            lower = (1 - t) * y[bottom, left] + t * y[bottom, right]
            result[i, j] = (1 - s) * upper + s * lower
    return result


def min_pool(edges: Edges, factor: int) -> Edges:
    """Between two neighbouring cells: the smallest edge between their centres, both ends included, full width.

    Lengths are in half pixels, so that everything is a whole number: the middle of pixel i is at 2i + 1, the edge
    between i and i+1 at 2i + 2, the centre of cell I at factor·(2I + 1).
    """

    def pool(fine: np.ndarray) -> np.ndarray:
        h, w = fine.shape[0] + 1, fine.shape[1]
        result = np.empty((math.ceil(h / factor) - 1, math.ceil(w / factor)))
        for i in range(result.shape[0]):
            for j in range(result.shape[1]):
                here, there = factor * (2 * i + 1), factor * (2 * i + 3)
                result[i, j] = min(
                    fine[a, b]
                    for a in range(h - 1)
                    for b in range(j * factor, min((j + 1) * factor, w))
                    if here <= 2 * a + 2 <= there
                )
        return result

    return pool(np.asarray(edges[0])), pool(np.asarray(edges[1]).T).T


def cascade(
    y: np.ndarray,
    guide: np.ndarray,
    levels: list[tuple[int, np.ndarray, float]],
    pooling: str = "edges",
    norm: str = "l2",
) -> np.ndarray:
    """Eq. 4. `levels` are (factor, step sizes, κ), coarse to fine; `pooling` is where the minimum is taken."""
    full = y.shape[0], y.shape[1]
    before = levels[0][0]
    y = downsample(y, before)
    for factor, step_sizes, kappa in levels:
        if factor != before:
            y = upsample(y, before // factor, (math.ceil(full[0] / factor), math.ceil(full[1] / factor)))
        if pooling == "edges":
            edges = min_pool(conductance(guide, kappa, norm), factor)
        else:
            edges = conductance(downsample(guide, factor), kappa, norm)
        y = diffuse(y, edges, step_sizes)
        before = factor
    return upsample(y, before, full)
