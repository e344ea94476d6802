"""Ways to repair a filter beyond the paper's, each by itself and together: what `experiments.beyond` compares.

All but the paper's own work on linear light, a channel for each light. Most change one thing about *holes unknown*,
the paper's cascade of 80 steps as a normalised convolution, so that what each is worth by itself can be told.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import ndimage

import hyjax
from experiments.judging import JUMP
from experiments.paper_view import View, with_kappa
from hyjax.core.cycles import longest_time, shortest_cycle
from hyjax.core.diffusion import edge_stopping, guide_distance
from hyjax.core.pyramid import downsample, level_shape, upsample
from hyjax.core.schedule import DEFAULT_KAPPA, Level, Schedule
from hyjax.core.stencil import Edges
from hyjax.light.gbuffer import GBuffer
from hyjax.light.setup import LightSetup
from hyjax.util.geometry import dot

Refine = Callable[[View, LightSetup, float], Float[Array, "h w l"]]

BASE = Schedule.preset("paper-80")
OURS = Schedule.preset("hyjax")
REACH = 9 / 512  # of the picture's height: how near to a depth jump a pixel is doubtful
DOUBT = 0.1
"""Confidence of what is doubtful."""
TRUE_DEPTH = 0.05
"""Metres from the accurate surface within which the rough one is right, to whoever knows both."""
FIDELITY = 0.1
CONVERGED_FIDELITY = 0.005
LOG_OFFSET = 2.0
"""Lux added before the logarithm."""


def known(
    view: View,
    setup: LightSetup,
    kappa: float,
    *,
    schedule: Schedule = BASE,
    trust: Callable[[View], Array] | None = None,
) -> Array:
    """`cascade_known` on the light of each lamp."""
    confidence = view.rough.hit[..., None] if trust is None else trust(view)
    return hyjax.cascade_known(lux(view, setup), confidence, view.guide, with_kappa(schedule, kappa))


def lux(view: View, setup: LightSetup) -> Float[Array, "h w l"]:
    return hyjax.shade_each(view.rough, setup.lights)


def black_holes(view: View, setup: LightSetup, kappa: float) -> Array:
    """The paper's cascade, holes black, in linear light."""
    return hyjax.cascade(lux(view, setup), view.guide, with_kappa(BASE, kappa))


# ---- confidence ----


def silhouettes(view: View) -> Float[Array, "h w 1"]:
    """Doubtful near the rough surface's depth jumps and holes."""
    hit, depth = np.asarray(view.rough.hit), np.asarray(view.rough.depth)
    reach = 2 * round(0.5 * REACH * hit.shape[0]) + 1
    far = ndimage.maximum_filter(np.where(hit, depth, 0.0), reach)
    near = ndimage.minimum_filter(np.where(hit, depth, np.inf), reach)
    beside = (far > (1 + JUMP) * near) | ~ndimage.minimum_filter(hit, reach)
    return jnp.asarray(np.where(hit, np.where(beside, DOUBT, 1.0), 0.0), jnp.float32)[..., None]


def grazing(view: View) -> Float[Array, "h w 1"]:
    """The less certain the flatter the surface is seen: the root of the cosine."""
    towards = jnp.asarray(-view.camera.rays(), jnp.float32)
    cosine = dot(view.rough.normal, towards) / jnp.sqrt(dot(towards, towards))
    return jnp.where(view.rough.hit, jnp.sqrt(jnp.clip(cosine, 0.02, 1.0)), 0.0)[..., None]


def perfect(view: View) -> Float[Array, "h w 1"]:
    """Doubtful where the rough surface is not the accurate one: what no method can know, as a bound."""
    right = jnp.abs(view.rough.depth - view.accurate.depth) < TRUE_DEPTH
    return jnp.where(view.rough.hit, jnp.where(right, 1.0, DOUBT), 0.0)[..., None]


# ---- schedules ----


def attached(schedule: Schedule) -> Schedule:
    """Schedule with a data term."""
    levels = tuple(dataclasses.replace(level, fidelity=np.float32(FIDELITY)) for level in schedule.levels)
    return dataclasses.replace(schedule, levels=levels)


def cycled(schedule: Schedule) -> Schedule:
    """One cycle a level, of as few steps as cover the level's diffusion time."""

    def cycle(level: Level) -> Level:
        time = float(np.sum(level.step_sizes))
        n = shortest_cycle(time)
        return dataclasses.replace(level, step_sizes=hyjax.step_cycle(n, min(time, longest_time(n))))

    return dataclasses.replace(schedule, levels=tuple(map(cycle, schedule.levels)), name=f"{schedule.name} cycles")


def equivalents(schedule: Schedule) -> float:
    """Steps at full size that take as many operations."""
    return sum(level.steps / level.factor**2 for level in schedule.levels)


# ---- what is diffused ----


def log_domain(view: View, setup: LightSetup, kappa: float) -> Array:
    """The logarithm of light instead of light."""
    logs = jnp.log(lux(view, setup) + LOG_OFFSET)
    refined = hyjax.cascade_known(logs, view.rough.hit[..., None], view.guide, with_kappa(BASE, kappa))
    return jnp.exp(refined) - LOG_OFFSET


def geometry(view: View, setup: LightSetup, kappa: float) -> Array:
    """Each pixel's plane (normal n and distance n·p) instead of its light; then shade.

    Any number of lights cost one repair, and holes in flat surfaces should come out flat.
    """
    seen, origin = view.rough, jnp.asarray(view.camera.origin, jnp.float32)
    rays = jnp.asarray(view.camera.rays(), jnp.float32)
    planes = jnp.concatenate([seen.normal, dot(seen.normal, seen.position - origin)[..., None]], axis=-1)
    refined = hyjax.cascade_known(planes, seen.hit[..., None], view.guide, with_kappa(BASE, kappa))
    normal, distance = refined[..., :3], refined[..., 3]
    # Seen from its front a plane has n·ray < 0 and a negative distance; a mean of several may have neither.
    depth = jnp.clip(distance / jnp.minimum(dot(normal, rays), -1e-2), 0.05, 30.0)
    position = jnp.where(seen.hit[..., None], seen.position, origin + rays * depth[..., None])
    length = jnp.sqrt(dot(normal, normal))[..., None]
    filled = GBuffer(position, normal / jnp.maximum(length, 1e-6), depth, jnp.ones_like(seen.hit))
    return hyjax.shade_each(filled, setup.lights)


# ---- how ----


def converged(view: View, setup: LightSetup, kappa: float) -> Array:
    """The full-size flow with a data term, at rest."""
    weight = view.rough.hit[..., None].astype(jnp.float32)
    weighted = jnp.concatenate([lux(view, setup) * weight, weight], axis=-1)
    solution = _converged(weighted, view.guide, jnp.float32(kappa))
    return solution[..., :-1] / jnp.maximum(solution[..., -1:], 1e-6)


@jax.jit
def _converged(weighted: Array, guide: Array, kappa: Array) -> Array:
    return hyjax.solve(weighted, hyjax.conductance(guide, kappa), CONVERGED_FIDELITY, tolerance=1e-4)


def harmonic(view: View, setup: LightSetup, kappa: float) -> Array:
    """Conductances of coarse cells by resistances in series across and conductances side by side, not the least."""
    weight = view.rough.hit[..., None].astype(jnp.float32)
    weighted = jnp.concatenate([lux(view, setup) * weight, weight], axis=-1)
    refined = _harmonic_cascade(weighted, view.guide, jnp.float32(kappa))
    return refined[..., :-1] / jnp.maximum(refined[..., -1:], 1e-6)


@jax.jit
def _harmonic_cascade(y: Array, guide: Array, kappa: Array) -> Array:
    fine = edge_stopping(guide_distance(guide), kappa)
    size, coarser = (y.shape[0], y.shape[1]), BASE.levels[0].factor
    state = downsample(y, coarser)
    for level in BASE.levels:
        state = upsample(state, coarser // level.factor, level_shape(size, level.factor))
        state = hyjax.diffuse(state, harmonic_pool(fine, level.factor), level.step_sizes)
        coarser = level.factor
    return upsample(state, coarser, size)


def harmonic_pool(edges: Edges, factor: int) -> Edges:
    """Harmonic means, for sizes that the factor divides."""
    vertical, horizontal = edges
    return _harmonic(vertical, factor), _harmonic(horizontal.T, factor).T


def _harmonic(edges: Float[Array, "h-1 w"], factor: int) -> Float[Array, "h/f-1 w/f"]:
    first, rows, columns = (factor - 1) // 2, (edges.shape[0] + 1) // factor - 1, edges.shape[1] // factor
    between = (1.0 / edges[first : first + factor * rows]).reshape(rows, factor, edges.shape[1])
    return (factor / jnp.sum(between, axis=1)).reshape(rows, columns, factor).mean(axis=-1)


# ---- all ----


@dataclasses.dataclass(frozen=True)
class Idea:
    """A row of the table.

    Attributes:
        refine: a view's light under a set-up, repaired with a κ.
        schedule: whose steps it takes; None if it takes none.
        kind: `"base"`, `"alone"`, `"together"` or `"bound"`, which no method can reach.
    """

    refine: Refine
    schedule: Schedule | None = BASE
    kind: str = "alone"


_guided = dataclasses.replace(BASE, pooling="guide")

IDEAS: Mapping[str, Idea] = {
    "black holes": Idea(black_holes, kind="base"),
    "holes unknown": Idea(known, kind="base"),
    "doubtful silhouettes": Idea(functools.partial(known, trust=silhouettes)),
    "doubtful grazing angles": Idea(functools.partial(known, trust=grazing)),
    "data term": Idea(functools.partial(known, schedule=attached(BASE))),
    "step cycles": Idea(functools.partial(known, schedule=cycled(BASE)), cycled(BASE)),
    "pooled guides": Idea(functools.partial(known, schedule=_guided)),
    "guided upsampling": Idea(functools.partial(known, schedule=dataclasses.replace(BASE, upsampling="guide"))),
    "harmonic coarsening": Idea(harmonic),
    "logarithm of light": Idea(log_domain),
    "geometry diffused": Idea(geometry),
    "converged": Idea(converged, None),
    "all that pays, 80 steps": Idea(
        functools.partial(known, schedule=attached(dataclasses.replace(_guided, upsampling="guide"))),
        kind="together",
    ),
    "hyjax": Idea(functools.partial(known, schedule=OURS), OURS, "together"),
    "hyjax, doubtful silhouettes": Idea(
        functools.partial(known, schedule=OURS, trust=silhouettes), OURS, "together"
    ),
    "hyjax, perfect confidence": Idea(functools.partial(known, schedule=OURS, trust=perfect), OURS, "bound"),
}

KAPPAS = (0.0025, 0.005, 0.01, DEFAULT_KAPPA, 0.05, 0.1)
