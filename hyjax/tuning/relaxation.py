"""Relaxed cascade with real-valued step counts, in which levels may vanish, for gradients of the search.

What is searched has the form of our presets: conductances and interpolation from guides at the levels' resolution,
and a data term.

Symbols of this file: the *factors* are all that may be used, coarse to fine; n_l, κ_l, λ_l, α_l belong to
level l; p_l = min(1, n_l) says how far the level is there at all.

- Step i of a level has size λ·clip(n − i, 0, 1): the last of n steps is scaled, so that the result is continuous
  and piecewise differentiable in n.
- A level takes its input from the nearest coarser level that is there, and from the picture itself where none is.
  With p between 0 and 1 that is a mixture, weighted by p_k ∏ (1 − p_j) over the levels j between. With whole n the
  relaxation *is* the cascade without the levels of n = 0; a test holds us to it.

Step counts are traced values and blocks of steps that are not needed are skipped at run time, so one compilation
serves all candidates. Conductance distances and cell means do not depend on what is searched and are made once.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.core.diffusion import diffuse, edge_stopping, guide_distance
from hyjax.core.pyramid import downsample
from hyjax.core.refine import HOLE_FLOOR
from hyjax.core.schedule import GUIDED_FIDELITY, GUIDED_KAPPA, Level, Schedule
from hyjax.core.stencil import Edges
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.core.upsampling import guided_upsample
from hyjax.light.shading import mix_channels
from hyjax.metrics.losses import display_loss, display_unclipped
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.cases import Case, filter_colors
from hyjax.util.geometry import TINY

BLOCK_STEPS = 8
KAPPA_RANGE = (1e-3, 1.0)
"""Range of κ for guides in [0, 1], of which an edge of full contrast differs by √3."""
LAM_RANGE = (0.01, 0.2499)
FIDELITY_RANGE = (1e-4, 10.0)
RANGES = {"kappa": KAPPA_RANGE, "lam": LAM_RANGE, "fidelity": FIDELITY_RANGE}
"""Ranges by the names of the choices."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class RelaxedSchedule:
    """A point of the search space; all are real numbers without bounds, so that optimisers may step freely.

    Attributes:
        steps: n_l ≥ 0 (kept by projection, see `hyjax.tuning.budget.project`).
        log_kappa: κ = exp(·).
        logit_lam: λ = sigmoid(·)/4, inside (0, 1/4).
        log_fidelity: α = exp(·).
    """

    steps: Float[Array, "l"]
    log_kappa: Float[Array, "l"]
    logit_lam: Float[Array, "l"]
    log_fidelity: Float[Array, "l"]

    @classmethod
    def of(
        cls,
        steps: Sequence[float] | np.ndarray,
        kappa: float | Sequence[float] = GUIDED_KAPPA,
        lam: float = DEFAULT_LAM,
        fidelity: float | Sequence[float] = GUIDED_FIDELITY,
    ) -> "RelaxedSchedule":
        """A point with these n_l, κ, λ and α."""
        n = np.asarray(steps, np.float32)
        log_kappa, log_fidelity = (
            jnp.asarray(np.log(np.broadcast_to(np.asarray(value, np.float32), n.shape)))
            for value in (kappa, fidelity)
        )
        lams = jnp.full(n.shape, logit(4.0 * lam), jnp.float32)
        return cls(jnp.asarray(n), log_kappa, lams, log_fidelity)

    @property
    def kappa(self) -> Float[Array, "l"]:
        return jnp.exp(self.log_kappa)

    @property
    def lam(self) -> Float[Array, "l"]:
        return 0.25 * jax.nn.sigmoid(self.logit_lam)

    @property
    def fidelity(self) -> Float[Array, "l"]:
        return jnp.exp(self.log_fidelity)

    def schedule(self, factors: Sequence[int], name: str = "tuned") -> Schedule:
        """The cascade that this point stands for; step counts are rounded, levels without steps left out."""
        levels = []
        columns = factors, np.round(self.steps), self.kappa, self.lam, self.fidelity
        for factor, n, kappa, lam, fidelity in zip(*columns, strict=True):
            if n > 0:
                step_sizes = np.full(int(n), np.float32(lam))
                levels.append(Level(int(factor), step_sizes, np.float32(kappa), np.float32(fidelity)))
        return Schedule(tuple(levels), pooling="guide", name=name, upsampling="guide").check()


def logit(p: float) -> float:
    """Inverse of the logistic function."""
    return float(np.log(p) - np.log1p(-p))


def relaxed_of(schedule: Schedule, factors: Sequence[int]) -> RelaxedSchedule:
    """A schedule as a relaxed one; λ is the mean of a level's steps, a level that it lacks is like the nearest."""
    levels = {level.factor: level for level in schedule.levels}
    near = [levels[min(levels, key=lambda own: abs(math.log2(own / factor)))] for factor in factors]
    steps = [levels[factor].steps if factor in levels else 0 for factor in factors]
    kappa = [float(np.asarray(level.kappa)) for level in near]
    weights = [FIDELITY_RANGE[0] if x.fidelity is None else float(np.asarray(x.fidelity)) for x in near]
    lam = [float(np.mean(np.asarray(level.step_sizes))) if level.steps else DEFAULT_LAM for level in near]
    point = RelaxedSchedule.of(steps, kappa, fidelity=[max(x, FIDELITY_RANGE[0]) for x in weights])
    logits = [logit(4.0 * min(max(x, LAM_RANGE[0]), LAM_RANGE[1])) for x in lam]
    return dataclasses.replace(point, logit_lam=jnp.asarray(logits, jnp.float32))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Parts of a case that no candidate changes: cell means of (w y, w) and of the guide, the target.

    Attributes:
        entries: for each factor, and last for the full picture.
        guides: likewise.
        distances: of these, for each factor.
        mean: of all that is known.
        picture: colours of the lights, frame, target in display values, where that is valid.
    """

    entries: tuple[Float[Array, "ch cw c"], ...]
    guides: tuple[Float[Array, "ch cw f"], ...]
    distances: tuple[Edges, ...]
    mean: Float[Array, "l"]
    picture: tuple[Array, ...] = ()


@functools.partial(jax.jit, static_argnames="factors")
def prepare(case: Case, factors: tuple[int, ...]) -> Prepared:
    """Everything about a case that the search needs again and again."""
    picture = filter_colors(case.shaded), case.frame, display_unclipped(case.target, case.frame), case.valid
    shaded = case.shaded
    return prepare_channels(shaded.illuminance, shaded.confidence, case.guide, factors, *picture)


def prepare_channels(
    channels: Float[Array, "h w c"],
    confidence: Float[Array, "h w 1"],
    guide: Float[Array, "h w f"],
    factors: tuple[int, ...],
    *picture: Array,
) -> Prepared:
    """Parts of a case that no candidate changes.

    Args:
        picture: colours, frame, target and where it is valid, for a loss.
    """
    usable = jnp.isfinite(channels).all(axis=-1, keepdims=True) & jnp.isfinite(confidence)
    weight = jnp.where(usable, confidence.astype(channels.dtype), 0.0)  # as `cascade_known` has it
    weighted = jnp.concatenate([jnp.where(weight > 0, channels, 0.0) * weight, weight], axis=-1)
    total = jnp.sum(weighted, axis=(0, 1))
    guides = tuple(downsample(guide, factor) for factor in factors)
    return Prepared(
        entries=(*(downsample(weighted, factor) for factor in factors), weighted),
        guides=(*guides, guide),
        distances=tuple(guide_distance(guide) for guide in guides),
        mean=total[:-1] / jnp.maximum(total[-1], TINY),
        picture=picture,
    )


def relaxed_cascade(prepared: Prepared, point: RelaxedSchedule, factors: tuple[int, ...]) -> Float[Array, "h w c"]:
    """The cascade of `point` on (w y, w), full size."""
    present = jnp.clip(point.steps, 0.0, 1.0)
    kappa, lam, fidelity = point.kappa, point.lam, point.fidelity
    states: list[Array] = []
    for level in range(len(factors)):

        def refine(states: list[Array], level: int = level) -> Array:
            state = _arriving(states, prepared, present, kappa, factors)
            edges = edge_stopping(prepared.distances[level], kappa[level])
            data_term = fidelity[level], prepared.entries[level]
            return _real_steps(state, edges, lam[level], point.steps[level], *data_term)

        absent = jnp.zeros_like(prepared.entries[level])
        states.append(jax.lax.cond(point.steps[level] > 0, refine, lambda _, absent=absent: absent, states))
    return _arriving(states, prepared, present, kappa, factors)


def _arriving(
    states: list[Array],
    prepared: Prepared,
    present: Float[Array, "l"],
    kappa: Float[Array, "l"],
    factors: tuple[int, ...],
) -> Float[Array, "ch cw c"]:
    """Start of the level after these, or the full picture; sources of no weight cost nothing."""
    level = len(states)
    factor = (*factors, 1)[level]
    entry, guide, free = prepared.entries[level], prepared.guides[level], jnp.ones(())
    total = jnp.zeros_like(entry)
    for coarser in reversed(range(level)):

        def source(state: Array, coarser: int = coarser) -> Array:
            cells = prepared.guides[coarser]
            return guided_upsample(state, factors[coarser] // factor, guide, kappa[coarser], coarse=cells)

        total = _add(total, free * present[coarser], source, states[coarser])
        free = free * (1.0 - present[coarser])
    return _add(total, free, lambda entry: entry, entry)


def _add(total: Array, weight: Array, source: Callable[[Array], Array], state: Array) -> Array:
    """total + weight · source(state)."""

    @jax.checkpoint
    def more(total: Array, state: Array, weight: Array) -> Array:
        return jax.lax.cond(weight > 0, lambda t, s, w: t + w * source(s), lambda t, s, w: t, total, state, weight)

    return more(total, state, weight)


def _real_steps(state: Array, edges: Edges, lam: Array, steps: Array, fidelity: Array, source: Array) -> Array:
    """`steps` steps of which the last is scaled, in blocks; blocks beyond the last step are skipped."""

    @jax.checkpoint
    def block(state: Array, first: Array) -> tuple[Array, None]:
        sizes = lam * jnp.clip(steps - first - jnp.arange(BLOCK_STEPS), 0.0, 1.0)

        def run(state: Array) -> Array:
            return diffuse(state, edges, sizes, fidelity=fidelity, source=source)

        return jax.lax.cond(first < steps, run, lambda s: s, state), None

    return jax.lax.scan(block, state, jnp.arange(0.0, MOST_STEPS, BLOCK_STEPS))[0]


def relaxed_channels(prepared: Prepared, point: RelaxedSchedule, factors: tuple[int, ...]) -> Float[Array, "h w c"]:
    """`cascade_known` with real-valued steps."""
    diffused = relaxed_cascade(prepared, point, factors)
    reached = diffused[..., -1:]
    floor = HOLE_FLOOR * (1.0 - reached)
    return (diffused[..., :-1] + floor * prepared.mean) / (reached + floor)


def relaxed_filter(prepared: Prepared, point: RelaxedSchedule, factors: tuple[int, ...]) -> Float[Array, "h w 3"]:
    """The filter of `point`."""
    return mix_channels(relaxed_channels(prepared, point, factors), prepared.picture[0])


def relaxed_loss(point: RelaxedSchedule, prepared: Prepared, factors: tuple[int, ...]) -> Float[Array, ""]:
    """Objective of the search on one frame."""
    _, frame, target, valid = prepared.picture
    return display_loss(display_unclipped(relaxed_filter(prepared, point, factors), frame), target, valid)


evaluate = functools.partial(jax.jit, static_argnames="factors")(relaxed_loss)
evaluate_with_gradient = functools.partial(jax.jit, static_argnames="factors")(jax.value_and_grad(relaxed_loss))
