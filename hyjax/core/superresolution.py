"""Guided super-resolution: diffusion under a guide, constrained to the cell means of a coarse source.

A coarse picture, the source, gives the mean of every cell; the guide says where values may flow. After each step
of diffusion the state is multiplied, cell by cell, by the ratio of the source to its own mean, so that details come
from the guide and means from the source. This is what guides are trained and judged with: depth, which changes
where objects end, as illumination does.

Symbols of this file: y (H, W, C) is the state, source (⌈H/f⌉, ⌈W/f⌉, C) the means of its cells of f×f pixels. Both
must be positive for their ratio to mean anything.

Source: Metzger et al., *Guided Depth Super-Resolution by Deep Anisotropic Diffusion*, CVPR 2023, equation 3.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from hyjax.core.cascade import level_edges
from hyjax.core.checks import check_edges, check_step_sizes
from hyjax.core.diffusion import channels_first, diffuse, explicit_step, scan_steps
from hyjax.core.pyramid import LARGEST_FACTOR, downsample, level_shape, upsample
from hyjax.core.schedule import Schedule
from hyjax.core.stencil import Edges
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

SHARE_ROUNDING = 1e-6
"""Rounding of the share of a cell's pixels that are valid."""
EPSILON = 1e-8
"""Metzger's guard against division by zero."""


@checked_arguments
def super_resolve(
    source: Float[Array, "ch cw c"],
    known: Bool[Array, "ch cw"],
    guide: Float[Array, "h w f"],
    schedule: Schedule | str,
    factor: int,
    *,
    start: Float[Array, "h w c"] | None = None,
    adjusted: bool = True,
) -> Float[Array, "h w c"]:
    """Super-resolve a coarse picture under a guide, coarse to fine.

    Diffuses through the schedule's levels as `cascade` does. On levels finer than the source every step is followed
    by `adjust`, and so is the picture at the end. A schedule of the one level of factor 1, with the bicubic
    interpolation of the source as `start`, makes this Metzger's algorithm.

    >>> source, known = jnp.array([[[1.0], [3.0]]]), jnp.ones((1, 2), bool)
    >>> fine = super_resolve(source, known, jnp.zeros((2, 4, 3)), Schedule.uniform([(1, 5)]), 2)
    >>> fine.shape, [round(float(x), 3) for x in downsample(fine, 2)[0, :, 0]]
    ((2, 4, 1), [1.0, 3.0])

    Args:
        source: cell means of the picture, positive. Also where not `known` it should hold something plausible,
            since that takes part in the diffusion; see `coarsen`.
        known: cells that the result must agree with.
        guide: features of the frame at full size.
        schedule: or a preset's name; each level's factor must divide `factor` or be a multiple of it.
        factor: how much coarser the source is.
        start: picture whose cell means enter at the coarsest level; by default the source's own, or the source
            interpolated bilinearly where the level is finer.
        adjusted: keep to the source; otherwise it only enters at the start.

    Raises:
        InputError: shapes that do not belong together, or a schedule that cannot be run, does not fit the factor,
            or has cycles of steps, a data term or guided upsampling.
    """
    schedule = Schedule.of(schedule).check()
    if schedule.upsampling != "bilinear" or any(level.fidelity is not None for level in schedule.levels):
        raise InputError(
            f"super_resolve: schedule {schedule.name} has a data term or guided upsampling, which do nothing for a "
            "result that keeps to its source; give one without these, such as the paper's"
        )
    for level in schedule.levels:
        _check_single_steps(level.step_sizes)
    h, w = guide.shape[:2]
    check_source((h, w), source, known, factor)
    for level in schedule.levels:
        if factor % level.factor and level.factor % factor:
            raise InputError(
                f"super_resolve: schedule {schedule.name} has a level of factor {level.factor}, which neither "
                f"divides the source's factor {factor} nor is a multiple of it"
            )
    if start is not None and start.shape != (h, w, source.shape[2]):
        raise InputError(
            f"start: shape {start.shape} does not fit the guide's {h}x{w} and {source.shape[2]} channels"
        )
    return _super_resolve(source, known, guide, schedule, start, factor=factor, adjusted=adjusted)


@functools.partial(jax.jit, static_argnames=("factor", "adjusted"))
def _super_resolve(
    source: Float[Array, "ch cw c"],
    known: Bool[Array, "ch cw"],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    start: Float[Array, "h w c"] | None,
    *,
    factor: int,
    adjusted: bool,
) -> Float[Array, "h w c"]:
    full = guide.shape[0], guide.shape[1]
    coarser = schedule.levels[0].factor
    if start is not None:
        state = downsample(start, coarser)
    elif coarser >= factor:
        state = downsample(source, coarser // factor)
    else:
        state = upsample(source, factor // coarser, level_shape(full, coarser))
    for level, edges in zip(schedule.levels, level_edges(guide, schedule), strict=True):
        state = upsample(state, coarser // level.factor, level_shape(full, level.factor))
        coarser = level.factor
        if adjusted and coarser < factor:
            state = diffuse_adjusted(state, edges, level.step_sizes, source, known, factor // coarser)
        else:
            state = diffuse(state, edges, level.step_sizes)
    state = upsample(state, coarser, full)
    return adjust(state, source, known, factor) if adjusted else state


def adjust(
    y: Float[Array, "h w c"], source: Float[Array, "ch cw c"], known: Bool[Array, "ch cw"], factor: int
) -> Float[Array, "h w c"]:
    """Multiply every cell by the ratio of the source to the cell's mean (Metzger's equation 3).

    >>> y = adjust(jnp.ones((2, 4, 1)), jnp.array([[[2.0], [3.0]]]), jnp.array([[True, False]]), 2)
    >>> y[0, :, 0].tolist()
    [2.0, 2.0, 1.0, 1.0]

    Args:
        y: picture, positive.
        source: what the means of its cells should be, positive.
        known: cells to adjust; the others stay.
        factor: pixels a cell is wide.

    Returns:
        A picture whose cell means are the source where known.
    """
    check_source((y.shape[0], y.shape[1]), source, known, factor)
    return jnp.moveaxis(_adjust(jnp.moveaxis(y, -1, 0), jnp.moveaxis(source, -1, 0), known, factor), 0, -1)


def diffuse_adjusted(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[ArrayLike, "n"] | Sequence[float],
    source: Float[Array, "ch cw c"],
    known: Bool[Array, "ch cw"],
    factor: int,
) -> Float[Array, "h w c"]:
    """`diffuse` with `adjust` after every step. The gradient takes memory like the root of the number of steps.

    >>> y, edges = jnp.array([[[1.0], [3.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> source, known = jnp.array([[[2.0]]]), jnp.ones((1, 1), bool)
    >>> diffuse_adjusted(y, edges, jnp.full(20, 0.2), source, known, 2)[..., 0].round(2).tolist()
    [[2.0, 2.0]]
    """
    check_step_sizes(step_sizes)
    _check_single_steps(step_sizes)
    check_edges(y, edges)
    check_source((y.shape[0], y.shape[1]), source, known, factor)
    return _diffuse_adjusted(y, edges, jnp.asarray(step_sizes, y.dtype), source, known, factor=factor)


def diffuse_adjusted_forward(
    y: Float[Array, "h w c"],
    edges: Edges,
    lam: Float[ArrayLike, ""],
    count: Int[ArrayLike, ""],
    source: Float[Array, "ch cw c"],
    known: Bool[Array, "ch cw"],
    factor: int,
) -> Float[Array, "h w c"]:
    """`diffuse_adjusted` with `count` steps of size λ, through which no gradient flows.

    The count may be traced, so that a random number of steps needs no new compilation.

    >>> y, edges = jnp.array([[[1.0], [3.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> source, known = jnp.array([[[2.0]]]), jnp.ones((1, 1), bool)
    >>> diffuse_adjusted_forward(y, edges, 0.2, 20, source, known, 2)[..., 0].round(2).tolist()
    [[2.0, 2.0]]
    """
    check_step_sizes(lam)
    check_edges(y, edges)
    check_source((y.shape[0], y.shape[1]), source, known, factor)
    y, edges, source, size = jax.lax.stop_gradient((y, edges, source, jnp.asarray(lam, y.dtype)))
    return _forward(y, edges, size, jnp.asarray(count), source, known, factor=factor)


@functools.partial(jax.jit, static_argnames="factor")
def _forward(
    y: Array, edges: Edges, lam: Array, count: Array, source: Array, known: Array, *, factor: int
) -> Float[Array, "h w c"]:
    state, edges = channels_first(y, edges)
    source = jnp.moveaxis(source, -1, 0)
    step = lambda _, x: _adjust(explicit_step(x, edges, lam), source, known, factor)  # noqa: E731
    return jnp.moveaxis(jax.lax.fori_loop(0, count, step, state), 0, -1)


@functools.partial(jax.jit, static_argnames="factor")
def _diffuse_adjusted(
    y: Array, edges: Edges, step_sizes: Array, source: Array, known: Array, *, factor: int
) -> Float[Array, "h w c"]:
    state, edges = channels_first(y, edges)
    source = jnp.moveaxis(source, -1, 0)
    step = lambda x, lam: _adjust(explicit_step(x, edges, lam), source, known, factor)  # noqa: E731
    return jnp.moveaxis(scan_steps(step, state, step_sizes), 0, -1)


@functools.partial(jax.jit, static_argnames="factor")
def _adjust(y: Float[Array, "c h w"], source: Float[Array, "c ch cw"], known: Array, factor: int) -> Array:
    # A channel at a time, as the loops have them first.
    means = jax.vmap(lambda plane: downsample(plane[..., None], factor)[..., 0])(y)
    ratio = jnp.where(known, source / (means + EPSILON), 1.0)
    nearest = jnp.repeat(jnp.repeat(ratio, factor, axis=-2), factor, axis=-1)
    return y * nearest[..., : y.shape[-2], : y.shape[-1]]


@functools.partial(jax.jit, static_argnames="factor")
def coarsen(
    y: Float[Array, "h w c"], valid: Bool[Array, "h w"], factor: int, *, least: Float[ArrayLike, ""] = 0.0
) -> tuple[Float[Array, "ch cw c"], Bool[Array, "ch cw"]]:
    """Coarse source of a picture with holes: means of each cell's valid pixels.

    >>> y, valid = jnp.array([[[2.0], [9.0]]]), jnp.array([[True, False]])
    >>> source, known = coarsen(y, valid, 2)
    >>> source.tolist(), known.tolist()
    ([[[2.0]]], [[True]])

    Args:
        y: picture; values that are not valid may be anything finite.
        valid: which of its pixels mean anything.
        factor: pixels a cell is wide.
        least: share of a cell's pixels that must be valid for it to count as known; one pixel at any rate, which
            is Metzger's choice.

    Returns:
        (source, known). A cell without any valid pixel holds the mean of the nearest larger cells that have some.
    """
    weight = downsample(valid[..., None].astype(y.dtype), factor)
    source = _filled(downsample(jnp.where(valid[..., None], y, 0.0), factor), weight)
    return source, (weight[..., 0] >= least - SHARE_ROUNDING) & (weight[..., 0] > 0)


def _filled(total: Float[Array, "h w c"], weight: Float[Array, "h w 1"]) -> Float[Array, "h w c"]:
    """Means total / weight; where the weight is zero, interpolated means of cells twice as wide."""
    mean = total / jnp.where(weight > 0, weight, 1.0)
    if total.shape[0] == total.shape[1] == 1:
        return mean
    coarser = _filled(downsample(total, 2), downsample(weight, 2))
    return jnp.where(weight > 0, mean, upsample(coarser, 2, total.shape[:2]))


def check_source(
    shape: tuple[int, int], source: Float[Array, "ch cw c"], known: Bool[Array, "ch cw"], factor: int
) -> None:
    """Raise `InputError` unless source and known cells have the shapes of a picture of `shape`.

    >>> check_source((4, 4), jnp.ones((2, 2, 1)), jnp.ones((2, 2), bool), 2)
    """
    if not 1 <= factor <= LARGEST_FACTOR:
        raise InputError(f"factor: must be a whole number in 1..{LARGEST_FACTOR}, got {shown(factor)}")
    cells = level_shape(shape, factor)
    if source.ndim != 3 or source.shape[:2] != cells or known.shape != cells:
        raise InputError(
            f"source: shape {source.shape} with known cells {known.shape} does not fit a picture of "
            f"{shape[0]}x{shape[1]} at factor {factor}, which has {cells[0]}x{cells[1]} cells"
        )


def _check_single_steps(step_sizes: Float[ArrayLike, "*n"] | Sequence[float]) -> None:
    """Raise `InputError` for cycles, whose stability is lost by adjusting between their steps."""
    values = concrete(step_sizes)
    if values is not None and (values >= 0.25).any():
        raise InputError("lam: super-resolution takes no cycles of steps; every step size must lie inside (0, 1/4)")
