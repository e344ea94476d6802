"""Resolution pyramid: cell means of pictures, cell minima of conductances, bilinear interpolation back up.

A level of factor f cuts the image into cells of f×f pixels, starting at the top left corner; where f does not
divide the image the last cells are cut off at the border, so a level has ⌈H/f⌉ × ⌈W/f⌉ cells and frames of any
size work. Centres of whole cells stay where they are on the image plane at every level (no half-pixel drift); a
cell cut off at the border stands for the pixels it has.
"""

import functools
from collections.abc import Callable, Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.core.stencil import CoarseEdges, Edges
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown

MOST_PHASES = 16
"""Largest factor whose upsampling is written out by phases, which is slow to compile for many phases."""
LARGEST_FACTOR = 1 << 30
"""Largest width of a cell in pixels."""


def level_shape(shape: tuple[int, int], factor: int) -> tuple[int, int]:
    """Rows and columns of cells of a picture of `shape` at `factor`.

    >>> level_shape((480, 640), 16), level_shape((5, 5), 2)
    ((30, 40), (3, 3))
    """
    return -(-shape[0] // factor), -(-shape[1] // factor)


@checked_arguments
@functools.partial(jax.jit, static_argnames="factor")
def downsample(y: Float[Array, "h w c"], factor: int) -> Float[Array, "ch cw c"]:
    """Mean over each cell (the ↓ of Eq. 4). Cells cut off by the border average the pixels they have.

    >>> downsample(jnp.arange(4.0).reshape(2, 2, 1), 2).tolist()
    [[[1.5]]]
    """
    _check_factor(factor)
    if factor == 1:
        return y
    h, w, _ = y.shape
    total = _sum_cells(_sum_cells(_summable(y), factor, 0), factor, 1)
    return (total * jnp.asarray(1.0 / cell_pixels((h, w), factor), total.dtype)).astype(y.dtype)


def cell_pyramid(y: Float[Array, "h w c"], factors: Iterable[int]) -> dict[int, Float[Array, "ch cw c"]]:
    """Cell means at several factors, each from the next finer factor that divides it: one pass over the picture.

    >>> {factor: cells.shape for factor, cells in cell_pyramid(jnp.ones((8, 6, 3)), (4, 2)).items()}
    {2: (4, 3, 3), 4: (2, 2, 3)}
    """
    sums, means, size = {1: _summable(y)}, {}, (y.shape[0], y.shape[1])
    for factor in sorted(factors):
        finer = max(f for f in sums if factor % f == 0)
        sums[factor] = _sum_cells(_sum_cells(sums[finer], factor // finer, 0), factor // finer, 1)
        mean = sums[factor] * jnp.asarray(1.0 / cell_pixels(size, factor), sums[factor].dtype)
        means[factor] = mean.astype(y.dtype)
    return means


def _summable(y: Array) -> Array:
    """Pixels in single precision at least: a sum over a cell overflows half precision."""
    return y.astype(jnp.promote_types(y.dtype, jnp.float32))


def _sum_cells(x: Array, factor: int, axis: int) -> Array:
    length = x.shape[axis]
    cells = -(-length // factor)
    # A single cell need not be padded to its full width.
    return _reduce_cells(x, factor if cells > 1 else length, cells, axis, jnp.add, 0.0)


def _pixels(length: int, factor: int) -> Float[np.ndarray, "n"]:
    """Number of pixels of each cell along an axis."""
    return np.minimum(factor, length - factor * np.arange(-(-length // factor))).astype(float)


def cell_pixels(shape: tuple[int, int], factor: int) -> Float[np.ndarray, "ch cw 1"]:
    """Number of pixels, of a picture of `shape`, in each cell of a level.

    >>> cell_pixels((3, 3), 2)[..., 0].tolist()
    [[4.0, 2.0], [2.0, 1.0]]
    """
    return np.outer(*(_pixels(length, factor) for length in shape))[..., None]


@checked_arguments
@functools.partial(jax.jit, static_argnames=("factor", "shape"))
def upsample(y: Float[Array, "ch cw c"], factor: int, shape: tuple[int, int]) -> Float[Array, "h w c"]:
    """Bilinear interpolation between cell centres (the ↑ of Eq. 4), constant beyond the outermost centres.

    >>> upsample(jnp.array([[[0.0], [1.0]]]), 2, (1, 4))[..., 0].tolist()
    [[0.0, 0.25, 0.75, 1.0]]

    Args:
        y: cells of a level.
        factor: how many times finer the result is.
        shape: rows and columns of the result; `y` must be the level of `factor` of a picture of this shape.

    Raises:
        InputError: factor below 1, or a `shape` that does not have `y`'s number of cells.
    """
    _check_factor(factor)
    if level_shape(shape, factor) != y.shape[:2]:
        raise InputError(
            f"shape: {y.shape[0]}x{y.shape[1]} cells times {factor} do not make a picture of {shape[0]}x{shape[1]}"
        )
    if factor == 1:
        return y
    lerp = _lerp_phases if factor <= MOST_PHASES else _lerp_intervals
    for axis in (0, 1):
        y = lerp(y, factor, shape[axis], axis)
    return y


def _lerp_intervals(y: Array, factor: int, length: int, axis: int) -> Array:
    """Interpolation by intervals: each pair of neighbouring cell centres has `factor` pixels, the same weights."""
    cells = y.shape[axis]
    if cells == 1:  # however much wider than the picture the cell is
        return jnp.broadcast_to(y, (*y.shape[:axis], length, *y.shape[axis + 1 :]))
    padded = jnp.pad(y, [(1, 1) if a == axis else (0, 0) for a in range(y.ndim)], mode="edge")
    first, second = (
        jnp.expand_dims(jax.lax.slice_in_dim(padded, k, k + cells + 1, axis=axis), axis + 1) for k in (0, 1)
    )
    position = (np.arange(factor) + (0.5 if factor % 2 == 0 else 0.0)) / factor  # from the first of two centres
    weight = jnp.asarray(np.expand_dims(position, [a for a in range(y.ndim + 1) if a != axis + 1]), y.dtype)
    shape = (*y.shape[:axis], (cells + 1) * factor, *y.shape[axis + 1 :])
    pixels = (first + weight * (second - first)).reshape(shape)
    start = (factor + 1) // 2  # pixels between the centre of the cell before the first one and the picture
    return jax.lax.slice_in_dim(pixels, start, start + length, axis=axis)


def _lerp_phases(y: Array, factor: int, length: int, axis: int) -> Array:
    """Interpolation by phases: pixels at the same place in their cell share two weights, in one fused slice-add."""
    cells = y.shape[axis]
    padded = jnp.pad(y, [(1, 1) if a == axis else (0, 0) for a in range(y.ndim)], mode="edge")
    shifted = [jax.lax.slice_in_dim(padded, k, k + cells, axis=axis) for k in range(3)]
    phases = []
    for phase in range(factor):
        position = (phase + 0.5) / factor - 0.5  # of the output pixel, in cells from its own cell's centre
        near, weight = (0, position + 1.0) if position < 0 else (1, position)
        phases.append(shifted[near] + weight * (shifted[near + 1] - shifted[near]))
    shape = (*y.shape[:axis], cells * factor, *y.shape[axis + 1 :])
    return jax.lax.slice_in_dim(jnp.stack(phases, axis=axis + 1).reshape(shape), 0, length, axis=axis)


@checked_arguments
def min_pool(edges: Edges, factor: int) -> CoarseEdges:
    """Conductances between the cells of a level: the smallest between two cell centres (Eq. 4).

    "Any edge pixel makes the whole cell an edge": the edge between two neighbouring cells takes the minimum over
    all fine edges of its direction that lie between the two cell centres, over the cells' whole width. Where a
    line of zero conductance separates two regions of pixels, it therefore separates them at every level; a test
    holds us to it. The interval is closed: an edge that lies exactly on a cell's centre line (even factors) counts
    for both sides, which keeps the pooling symmetric under flips.

    >>> edges = jnp.ones((3, 4)), jnp.ones((4, 3)).at[0, 1].set(0.0)
    >>> min_pool(edges, 2)[1].tolist()
    [[0.0], [1.0]]

    Args:
        edges: (vertical, horizontal) of the full picture, shapes (H−1, W) and (H, W−1).
        factor: pixels a cell is wide.

    Returns:
        (vertical, horizontal) of the level, shapes (⌈H/f⌉−1, ⌈W/f⌉) and (⌈H/f⌉, ⌈W/f⌉−1).

    Raises:
        InputError: factor below 1.
    """
    return _pool(edges, factor, jnp.minimum, np.inf)


def max_pool(edges: Edges, factor: int) -> CoarseEdges:
    """Largest value between two cell centres, pooled as by `min_pool`.

    c(d²) falls with d², so pooling squared guide distances with this and taking Eq. 3 of the result *is*
    min-pooling the conductances, at a fraction of the cost and with one pooling for all values of κ.

    >>> edges = jnp.zeros((3, 4)), jnp.zeros((4, 3)).at[0, 1].set(9.0)
    >>> max_pool(edges, 2)[1].tolist()
    [[9.0], [0.0]]
    """
    return _pool(edges, factor, jnp.maximum, -np.inf)


@functools.partial(jax.jit, static_argnames=("factor", "reduce", "fill"))
def _pool(edges: Edges, factor: int, reduce: Callable[[Array, Array], Array], fill: float) -> CoarseEdges:
    _check_factor(factor)
    vertical, horizontal = edges
    if factor == 1:
        return edges
    return (
        _pool_vertical(vertical, factor, reduce, fill),
        _pool_vertical(horizontal.T, factor, reduce, fill).T,
    )


def _pool_vertical(
    edges: Float[Array, "h_1 w"], factor: int, reduce: Callable[[Array, Array], Array], fill: float
) -> Float[Array, "ch_1 cw"]:
    h, w = edges.shape[0] + 1, edges.shape[1]
    rows, columns = level_shape((h, w), factor)
    if rows == 1:
        return jnp.zeros((0, columns), edges.dtype)
    edges = _reduce_cells(edges, factor if columns > 1 else w, columns, 1, reduce, fill)
    # Edge e lies between pixels e and e+1. Cell centres are at pixel f·I + (f−1)/2, hence the first edge:
    first = (factor - 1) // 2
    pooled = _reduce_cells(edges[first:], factor, rows - 1, 0, reduce, fill)
    if factor % 2 == 0:  # the edge on the next cell's centre line belongs to both
        last = _fit(edges[first + factor :], factor * (rows - 1), 0, fill)[::factor]
        pooled = reduce(pooled, last)
    return pooled


def _reduce_cells(
    x: Array, factor: int, cells: int, axis: int, reduce: Callable[[Array, Array], Array], fill: float
) -> Array:
    """Reduce runs of `factor` along `axis`, by strided slices, halving as long as the factor is even.

    XLA's CPU backend turns these into fast fused passes, which it does not do for its own reductions.
    """
    x = _fit(x, factor * cells, axis, fill)
    while factor > 1:
        run = 2 if factor % 2 == 0 else factor
        length = x.shape[axis]
        slices = [jax.lax.slice_in_dim(x, min(k, length), length, run, axis) for k in range(run)]
        x = functools.reduce(reduce, slices)
        factor //= run
    return x


def _fit(x: Array, length: int, axis: int, fill: float) -> Array:
    """Cut or pad `x` with `fill` at the end of `axis` to `length`."""
    x = jax.lax.slice_in_dim(x, 0, min(length, x.shape[axis]), axis=axis)
    missing = length - x.shape[axis]
    if missing == 0:
        return x
    return jnp.pad(x, [(0, missing) if a == axis else (0, 0) for a in range(x.ndim)], constant_values=fill)


def _check_factor(factor: int) -> None:
    if not 1 <= factor <= LARGEST_FACTOR:
        raise InputError(f"factor: must be a whole number in 1..{LARGEST_FACTOR}, got {shown(factor)}")
