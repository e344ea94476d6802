"""A cascade with real-valued step counts, in which levels may vanish: what the search takes gradients of.

Symbols of this file: the *ladder* is all factors that may be used, coarse to fine; n_l, κ_l, λ_l belong to level l;
p_l = min(1, n_l) says how far the level is there at all.

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
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hyjax.diffusion import diffuse, edge_stopping, guide_distance
from hyjax.lights import TINY
from hyjax.losses import as_seen, seen_loss
from hyjax.pyramid import downsample, level_shape, max_pool, upsample
from hyjax.refine import HOLE_FLOOR
from hyjax.schedule import DEFAULT_KAPPA, DEFAULT_LAM, Level, Schedule
from hyjax.stencil import Edges
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.cases import Case, mix

BLOCK = 8
KAPPA_RANGE = (1e-3, 1.0)
"""For guides in [0, 1], of which an edge of full contrast differs by √3."""
LAM_RANGE = (0.01, 0.2499)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """A point of the search space; all are real numbers without bounds, so that optimisers may step freely.

    Attributes:
        steps: n_l ≥ 0 (kept by projection, see `hyjax.tuning.budget.project`).
        log_kappa: κ = exp(·).
        logit_lam: λ = sigmoid(·)/4, inside (0, 1/4).
    """

    steps: Float[Array, "l"]
    log_kappa: Float[Array, "l"]
    logit_lam: Float[Array, "l"]

    @classmethod
    def of(
        cls,
        steps: Sequence[float] | np.ndarray,
        kappa: float | Sequence[float] = DEFAULT_KAPPA,
        lam: float = DEFAULT_LAM,
    ) -> "Plan":
        """A plan with these n_l, κ and λ."""
        n = np.asarray(steps, np.float32)
        log_kappa = np.log(np.broadcast_to(np.asarray(kappa, np.float32), n.shape))
        return cls(jnp.asarray(n), jnp.asarray(log_kappa), jnp.full(n.shape, logit(4.0 * lam), jnp.float32))

    @property
    def kappa(self) -> Float[Array, "l"]:
        return jnp.exp(self.log_kappa)

    @property
    def lam(self) -> Float[Array, "l"]:
        return 0.25 * jax.nn.sigmoid(self.logit_lam)

    def schedule(self, ladder: Sequence[int], name: str = "tuned") -> Schedule:
        """The cascade that this plan stands for; step counts are rounded, levels without steps left out.

        Raises:
            InputError: no level has a step.
        """
        levels = []
        for factor, n, kappa, lam in zip(ladder, np.round(self.steps), self.kappa, self.lam, strict=True):
            if n > 0:
                step_sizes = np.full(int(n), np.float32(lam))
                levels.append(Level(int(factor), step_sizes, np.float32(kappa)))
        return Schedule(tuple(levels), name=name).check()


def logit(p: float) -> float:
    """Inverse of the logistic function."""
    return float(np.log(p) - np.log1p(-p))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Of a case, all that no candidate changes: (w y, w) and its cell means, pooled guide distances, the target.

    Attributes:
        entries: for each factor of the ladder, and last for the full picture.
        distances: for each factor of the ladder.
        mean: of all that is known.
    """

    entries: tuple[Float[Array, "ch cw c"], ...]
    distances: tuple[Edges, ...]
    mean: Float[Array, "l"]
    colors: Float[Array, "l 3"]
    frame: Float[Array, "h w 3"]
    target_seen: Float[Array, "h w 3"]
    valid: Bool[Array, "h w"]


@functools.partial(jax.jit, static_argnames="ladder")
def prepare(case: Case, ladder: tuple[int, ...]) -> Prepared:
    """Everything about a case that the search needs again and again."""
    weight = case.known.astype(case.shading.dtype)
    weighted = jnp.concatenate([case.shading * weight, weight], axis=-1)
    total = jnp.sum(weighted, axis=(0, 1))
    fine = guide_distance(case.guide)
    return Prepared(
        entries=(*(downsample(weighted, factor) for factor in ladder), weighted),
        distances=tuple(max_pool(fine, factor) for factor in ladder),
        mean=total[:-1] / jnp.maximum(total[-1], TINY),
        colors=case.colors,
        frame=case.frame,
        target_seen=as_seen(case.target, case.frame),
        valid=case.valid,
    )


def relaxed_cascade(prepared: Prepared, plan: Plan, ladder: tuple[int, ...]) -> Float[Array, "h w c"]:
    """The cascade of `plan` on (w y, w), full size."""
    h, w, _ = prepared.entries[-1].shape
    present = jnp.clip(plan.steps, 0.0, 1.0)
    kappa, lam = plan.kappa, plan.lam
    states: list[Array] = []
    for level, factor in enumerate(ladder):

        def refine(states: list[Array], level: int = level, factor: int = factor) -> Array:
            state = _arriving(states, prepared.entries[level], present, ladder, factor, (h, w))
            edges = edge_stopping(prepared.distances[level], kappa[level])
            return _real_steps(state, edges, lam[level], plan.steps[level])

        absent = jnp.zeros_like(prepared.entries[level])
        states.append(jax.lax.cond(plan.steps[level] > 0, refine, lambda _, absent=absent: absent, states))
    return _arriving(states, prepared.entries[-1], present, ladder, 1, (h, w))


def _arriving(
    states: list[Array],
    entry: Float[Array, "ch cw c"],
    present: Float[Array, "l"],
    ladder: tuple[int, ...],
    factor: int,
    full: tuple[int, int],
) -> Float[Array, "ch cw c"]:
    """What a level of `factor` after these starts from; sources of no weight cost nothing."""
    shape, free = level_shape(full, factor), jnp.ones(())
    total = jnp.zeros_like(entry)
    for coarser in reversed(range(len(states))):
        source = functools.partial(upsample, factor=ladder[coarser] // factor, shape=shape)
        total = _add(total, free * present[coarser], source, states[coarser])
        free = free * (1.0 - present[coarser])
    return _add(total, free, lambda entry: entry, entry)


def _add(total: Array, weight: Array, source: Callable[[Array], Array], state: Array) -> Array:
    """total + weight · source(state)."""

    @jax.checkpoint
    def more(total: Array, state: Array, weight: Array) -> Array:
        return jax.lax.cond(weight > 0, lambda t, s, w: t + w * source(s), lambda t, s, w: t, total, state, weight)

    return more(total, state, weight)


def _real_steps(state: Array, edges: Edges, lam: Array, steps: Array) -> Array:
    """`steps` steps of which the last is scaled, in blocks; blocks beyond the last step are skipped."""

    @jax.checkpoint
    def block(state: Array, first: Array) -> tuple[Array, None]:
        sizes = lam * jnp.clip(steps - first - jnp.arange(BLOCK), 0.0, 1.0)
        return jax.lax.cond(first < steps, lambda s: diffuse(s, edges, sizes), lambda s: s, state), None

    return jax.lax.scan(block, state, jnp.arange(0.0, MOST_STEPS, BLOCK))[0]


def relaxed_filter(prepared: Prepared, plan: Plan, ladder: tuple[int, ...]) -> Float[Array, "h w 3"]:
    """The filter of `plan`: `cascade_known` with real-valued steps."""
    diffused = relaxed_cascade(prepared, plan, ladder)
    reached = diffused[..., -1:]
    floor = HOLE_FLOOR * (1.0 - reached)
    return mix((diffused[..., :-1] + floor * prepared.mean) / (reached + floor), prepared.colors)


def relaxed_loss(plan: Plan, prepared: Prepared, ladder: tuple[int, ...]) -> Float[Array, ""]:
    """What the search minimises, on one frame."""
    seen = as_seen(relaxed_filter(prepared, plan, ladder), prepared.frame)
    return seen_loss(seen, prepared.target_seen, prepared.valid)


evaluate = functools.partial(jax.jit, static_argnames="ladder")(relaxed_loss)
evaluate_with_gradient = functools.partial(jax.jit, static_argnames="ladder")(jax.value_and_grad(relaxed_loss))
