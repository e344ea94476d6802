"""Coarse-to-fine diffusion (Eq. 4)."""

import dataclasses
from collections.abc import Sequence

import jax
from jaxtyping import Array, Float

from hyjax.core.diffusion import diffuse, edge_stopping, guide_distance
from hyjax.core.pyramid import cell_pyramid, level_shape, max_pool, upsample
from hyjax.core.schedule import Level, Schedule
from hyjax.core.stencil import CoarseEdges
from hyjax.core.upsampling import upsample_between
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

LEAST_SAMPLES = 2
"""Fewest pixels along each side of a cell at the levels where a sampled picture enters."""


@checked_arguments
def cascade(
    y: Float[Array, "h w c"], guide: Float[Array, "h w f"], schedule: Schedule | str
) -> Float[Array, "h w c"]:
    """Diffuse coarse to fine under a guide (Eq. 4).

    The picture enters at the coarsest level as cell means and leaves the finest level by interpolation; each level
    adds its steps of diffusion with its own pooled conductances. Beyond the paper, a schedule may let each level
    hold on to its own cell means (`Level.fidelity`), which brings back detail that coarser levels have lost, and
    may interpolate under the guide (`Schedule.upsampling`).

    >>> import jax.numpy as jnp
    >>> y, guide = jnp.ones((8, 8, 1)).at[4, 4].set(9.0), jnp.zeros((8, 8, 3))
    >>> refined = cascade(y, guide, Schedule.uniform([(4, 8), (2, 8)]))
    >>> refined.shape, round(float(refined.mean()), 3), float(refined.max()) < 2.0
    ((8, 8, 1), 1.125, True)

    Args:
        y: the filter to repair, any number of channels.
        guide: features of the frame, same height and width. Nothing flows through cells that hold values that
            are not finite; they affect nothing beyond.
        schedule: levels with their steps, λ and κ, or a preset's name.

    Returns:
        The repaired filter, full size (S of Eq. 4).

    Raises:
        InputError: sizes of `y` and `guide` differ, or the schedule cannot be run (see `Schedule.check`).
    """
    schedule = Schedule.of(schedule).check(dtype=y.dtype)
    if y.shape[:2] != guide.shape[:2]:
        both = f"filter {y.shape} and guide {guide.shape}"
        raise InputError(f"cascade: {both} must both be H x W x channels, same H x W")
    return _cascade(y, guide, schedule)


def entries(schedule: Schedule) -> Sequence[int]:
    """Factors of the levels where the picture enters a cascade: the coarsest, and all with a fidelity.

    >>> entries(Schedule.preset("hyjax")), entries(Schedule.preset("paper-50"))
    ([16, 8, 4], [16])
    """
    return [level.factor for k, level in enumerate(schedule.levels) if k == 0 or level.fidelity is not None]


def largest_sampling(schedules: Sequence[Schedule], most: int) -> int:
    """Largest sampling up to `most` that keeps all levels, and four pixels of each cell where a picture enters.

    >>> largest_sampling([Schedule.preset("hyjax"), Schedule.preset("hyjax-scan-shadow")], 2)
    2
    >>> largest_sampling([Schedule.preset("hyjax"), Schedule.preset("hyjax-shadow")], 2)
    1
    """

    def allows(schedule: Schedule, sampling: int) -> bool:
        fine = any(factor % (LEAST_SAMPLES * sampling) for factor in entries(schedule))
        return not fine and len(sampled_schedule(schedule, sampling).levels) == len(schedule.levels)

    return max(k for k in range(1, max(most, 1) + 1) if k == 1 or all(allows(each, k) for each in schedules))


def sampled_schedule(schedule: Schedule, sampling: int) -> Schedule:
    """Schedule for pictures so many times smaller: its cells cover as much of the frame.

    Levels whose cells are no whole number of its pixels become one, at all pixels.

    >>> [level.factor for level in sampled_schedule(Schedule.preset("hyjax-scan-shadow"), 2).levels]
    [2, 1]
    """
    levels: list[Level] = []
    for level in schedule.levels:
        factor = 1 if level.factor % sampling else level.factor // sampling
        if not levels or factor < levels[-1].factor:
            levels.append(dataclasses.replace(level, factor=factor))
    return dataclasses.replace(schedule, levels=tuple(levels))


@jax.jit
def _cascade(y: Float[Array, "h w c"], guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w c"]:
    full, factors = (guide.shape[0], guide.shape[1]), [level.factor for level in schedule.levels]
    means = cell_pyramid(y, entries(schedule))
    guides = cell_pyramid(guide, [*factors, 1])
    coarser, kappa = factors[0], schedule.levels[0].kappa
    state = means[coarser]

    def upsample_to(state: Array, factor: int) -> Array:
        """Upsample from the last diffused level to a finer one."""
        if schedule.upsampling == "guide":
            cells, finer = guides[coarser], guides[factor]
            return upsample_between(state, coarser // factor, finer, cells, kappa, norm=schedule.norm)
        return upsample(state, coarser // factor, level_shape(full, factor))

    for level, edges in zip(schedule.levels, level_edges(guide, schedule), strict=True):
        state = upsample_to(state, level.factor)
        source = means.get(level.factor)
        state = diffuse(state, edges, level.step_sizes, fidelity=level.fidelity, source=source)
        coarser, kappa = level.factor, level.kappa
    return upsample_to(state, 1)


@checked_arguments
def level_edges(guide: Float[Array, "h w f"], schedule: Schedule | str) -> list[CoarseEdges]:
    """Conductances C^(l) of every level of a schedule, coarse to fine (Eq. 4).

    >>> import jax.numpy as jnp
    >>> schedule = Schedule.uniform([(4, 1), (2, 1)])
    >>> [vertical.shape for vertical, _ in level_edges(jnp.zeros((8, 8, 3)), schedule)]
    [(1, 2), (3, 4)]
    """
    schedule = Schedule.of(schedule)
    if schedule.pooling == "guide":
        guides = cell_pyramid(guide, [level.factor for level in schedule.levels])
        distances = [guide_distance(guides[level.factor], norm=schedule.norm) for level in schedule.levels]
    else:
        fine = guide_distance(guide, norm=schedule.norm)
        distances = [max_pool(fine, level.factor) for level in schedule.levels]
    return [edge_stopping(d, level.kappa) for d, level in zip(distances, schedule.levels, strict=True)]
