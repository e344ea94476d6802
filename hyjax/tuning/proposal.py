"""Relaxed proposal: levels and steps of a frame's cascade as real numbers, which follow the gradient of its loss.

The cascade of a configuration is replaced by `hyjax.tuning.relaxation`, all else of the frame stays: filling,
shadow pass and composite. Projected descent within a time, and the choice among the whole steps around its end, are
those of `hyjax.tuning.descent`.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.configuration import Configuration
from hyjax.light.light_edges import edge_correction, own_light, sharpened
from hyjax.scene.relighter import LitFrame, refine
from hyjax.tuning.budget import fits, moves, neighbours, project
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.descent import Found, Objective, promising, relax, whole, with_steps
from hyjax.tuning.evaluation import FrameCase, Judge, padded
from hyjax.tuning.refinement import lit_case
from hyjax.tuning.relaxation import Prepared, RelaxedSchedule, prepare_channels, relaxed_channels, relaxed_of
from hyjax.tuning.space import Choices, Space

ITERATIONS = 16
LEVEL_STEPS = 3.0
"""Cost of having a level at all, in steps of it: conductances, and interpolation to the next."""
CHECKED_POINTS = 3
"""Whole steps around the start, and around the end of the descent, of which the loss of a frame is computed."""
UNLIMITED_STEPS = 4.0
"""Without a budget, the cascade may take so many times as long as it does."""

Price = dict[int, float]
"""Time of one step at each factor, over that of the default's frame."""


@dataclasses.dataclass(frozen=True)
class FrameObjective(Objective):
    """Mean loss over frames, relative to that of a configuration, of a point in the place of its cascade.

    Attributes:
        configuration: of which the cascade is replaced.
        value: loss of a picture, see `PictureLoss.value`.
    """

    lit: Sequence[LitFrame] = ()
    gains: Sequence[Array] = ()
    targets: Sequence[tuple[Array, Array]] = ()
    configuration: Configuration = dataclasses.field(default_factory=Configuration)
    value: Callable[..., Array] = lambda *_: jnp.zeros(())

    @functools.cached_property
    def _slope(self) -> Callable[..., tuple[Array, RelaxedSchedule]]:
        def loss(point: RelaxedSchedule, prepared: Prepared, lit: LitFrame, *rest: Array) -> Array:
            return self.value(self._picture(point, prepared, lit), *rest)

        return jax.jit(jax.value_and_grad(loss))

    def _picture(self, point: RelaxedSchedule, prepared: Prepared, lit: LitFrame) -> Float[Array, "h w 3"]:
        def relaxed(_: Array, visibility: Array) -> tuple[Array, Array]:
            illuminance = relaxed_channels(prepared, point, self.factors)
            if lit.light_edges is not None and lit.shaded.photo_light is not None:
                correction = edge_correction(lit.view, own_light(illuminance), lit.light_edges)
                illuminance = sharpened(illuminance, correction)
            return illuminance, visibility

        schedule = self.configuration.schedule
        finest = jnp.max(jnp.where(point.steps > 0, jnp.arange(len(point.steps)), 0))
        last = dataclasses.replace(schedule.levels[-1], kappa=point.kappa[finest])  # that brings the filter up
        schedule = dataclasses.replace(schedule, levels=(*schedule.levels[:-1], last))
        stages = refine(lit, dataclasses.replace(self.configuration, schedule=schedule), temporal_filter=relaxed)
        picture: Array = next(result for stage, result in stages if stage == "composite")
        return picture

    def __call__(self, point: RelaxedSchedule) -> float:
        return float(self.gradient(point)[0])

    def part(self, point: RelaxedSchedule, frame: int) -> tuple[Array, RelaxedSchedule]:
        return self._slope(point, self.prepared[frame], self.lit[frame], self.gains[frame], *self.targets[frame])


def relaxed_choices(
    choices: Choices,
    space: Space,
    judge: Judge,
    cases: Sequence[FrameCase],
    *,
    price: Price,
    room: float,
    seed: int = 0,
    expired: Callable[[], bool] = lambda: False,
) -> Choices:
    """Choices with better levels and steps within a time; the same if there are none.

    Looked at are the end of a relaxed descent, and neighbours of the start that the gradient there promises.

    Args:
        cases: one of them is looked at in each iteration.
        room: time, over the default's frame's, that the cascade may take beyond its own; infinite for no budget.
    """
    configuration = space.configuration(choices)
    own, sampling = configuration.schedule, configuration.light.sampling
    known = [p.factor for p in space.parameters if p.cascade == "cascade"]
    factors = tuple(f for f in known if sampling == 1 or f % (2 * sampling) == 0)
    held = all(level.fidelity is not None for level in own.levels)
    if not held or own.pooling != "guide" or own.upsampling != "guide" or own.norm != "l2" or not factors:
        return choices  # the relaxation knows the form of our presets alone
    objective = frame_objective(configuration, judge, cases, factors)
    start = relaxed_of(own, factors)
    step = tuple(price[f] for f in factors)
    cost = CostModel(0.0, tuple(LEVEL_STEPS * x for x in step), step, (0.0,) * len(factors))
    spent = cost(np.asarray(start.steps).tolist()) if np.any(np.asarray(start.steps) > 0) else 0.0
    budget = spent + room if math.isfinite(room) else UNLIMITED_STEPS * spent
    if budget <= min(step) * (1 + LEVEL_STEPS):
        return choices
    found = relaxed_points(objective, start, cost, budget, seed=seed, expired=expired)
    return with_point(choices, space, found[0].point, factors) if found and found[0].point is not start else choices


def relaxed_points(
    objective: Objective,
    start: RelaxedSchedule,
    cost: CostModel,
    budget: float,
    *,
    iterations: int = ITERATIONS,
    looked_at: int = CHECKED_POINTS,
    seed: int = 0,
    expired: Callable[[], bool] = lambda: False,
) -> list[Found]:
    """Points of whole steps within a budget, the best first, with the start, cut down to the budget, among them.

    Args:
        looked_at: whole steps around the start, and around the end of the descent, of which the loss is computed.
    """
    if not fits(whole(start), cost, budget):
        start = with_steps(start, np.floor(project(np.asarray(start.steps), cost, budget)))
        if not np.any(np.asarray(start.steps)):
            return []
    before, slope = objective.gradient(start)
    found = [with_steps(start, n) for n in promising(moves(whole(start), cost, budget), start, slope, looked_at)]
    end = relax(objective, start, cost, budget, iterations, seed, expired)
    real = np.asarray(end.steps)
    if np.any(real > 0):
        near = neighbours(real, cost, budget)
        found += [with_steps(end, n) for n in promising(near, end, objective.gradient(end)[1], looked_at)]
    return sorted(
        [Found(start, float(before)), *(Found(p, objective(p)) for p in found)], key=lambda each: each.loss
    )


def with_point(choices: Choices, space: Space, point: RelaxedSchedule, factors: Sequence[int]) -> Choices:
    """Choices with the steps of a point, and with the numbers of its levels that the space has."""
    there = np.asarray(point.steps) > 0
    changed: Choices = {p.name: 0 for p in space.parameters if p.cascade == "cascade"}
    changed |= {f"cascade_{factor}": n for factor, n in zip(factors, whole(point))}
    for name, values in (("kappa", point.kappa), ("lam", point.lam), ("fidelity", point.fidelity)):
        if name in choices:
            low, high = space.named[name].values
            changed[name] = tuple(np.clip(np.asarray(values, float)[there], low, high).tolist())
    return space.complete(choices | changed)


def frame_objective(
    configuration: Configuration, judge: Judge, cases: Sequence[FrameCase], factors: tuple[int, ...]
) -> FrameObjective:
    """Objective on cases, with levels at factors of the configuration."""
    factors = tuple(factor // configuration.light.sampling for factor in factors)
    lit = [lit_case(configuration, judge, case) for case in cases]
    most = max(frame.shaded.illuminance.shape[-1] for frame, _, _ in lit)
    frames, gains, targets, prepared = [], [], [], []
    for frame, target, own in lit:
        frame = padded(frame, most)
        picture = next(result for stage, result in refine(frame, own) if stage == "composite")
        gains.append(jnp.asarray(judge.loss.gains(np.asarray(picture), target)))
        frames.append(frame)
        targets.append((jnp.asarray(target.picture), jnp.asarray(target.valid)))
        shaded = frame.shaded
        channels = jnp.concatenate([shaded.illuminance, *shaded.surface_fields], axis=-1)
        prepared.append(_prepare(channels, shaded.confidence, frame.features, factors))
    return FrameObjective(
        prepared, factors, frames, gains, targets, judge.scenes[cases[0][0]].judged(configuration), judge.loss.value
    )


_prepare = jax.jit(prepare_channels, static_argnums=3)
