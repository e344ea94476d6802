"""The relaxed cascade: with whole steps it is the real one; between them it is continuous, with true gradients."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax import InputError
from hyjax.core.schedule import DEFAULT_LAM, GUIDED_FIDELITY, GUIDED_KAPPA, Schedule
from hyjax.light.color import to_linear
from hyjax.light.shaded import Shaded
from hyjax.metrics.losses import filter_loss
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.cases import Case, raw_filter, refined_filter
from hyjax.tuning.descent import Objective, polish
from hyjax.tuning.relaxation import (
    BLOCK_STEPS,
    FIDELITY_RANGE,
    Prepared,
    RelaxedSchedule,
    evaluate,
    evaluate_with_gradient,
    logit,
    prepare,
    relaxed_filter,
)

FACTORS = (8, 4, 1)
SIZES = [(16, 24), (17, 13)]
"""Few: every one is compiled anew. The odd one has cut-off cells at every level but the finest."""

filter_of = functools.partial(jax.jit, static_argnames="factors")(relaxed_filter)


def case_of(size: tuple[int, int], seed: int = 0, lights: int = 2, holes: bool = True) -> Case:
    """Shading with noise and a hole too wide for a few steps to reach across."""
    rng = np.random.default_rng(seed)
    guide = rng.uniform(0.1, 0.9, (*size, 3)).astype(np.float32)
    known = np.ones((*size, 1), bool)
    if holes:
        known[2 : size[0] // 2, 3 : size[1] // 2] = False
    shading = rng.uniform(20.0, 400.0, (*size, lights)).astype(np.float32)
    colors = np.array([[1.0, 0.8, 0.6], [0.5, 0.7, 1.0]], np.float32)[:lights]
    target = rng.uniform(0.2, 2.0, (*size, 3)).astype(np.float32)
    valid = rng.uniform(size=size) < 0.9
    shading, confidence, colors, guide, target, valid = map(
        jnp.asarray, (shading, known.astype(np.float32), colors, guide, target, valid)
    )
    shaded = Shaded(shading, jnp.ones_like(shading), colors, confidence, jnp.asarray(200.0), jnp.ones(3))
    return Case(shaded, guide, to_linear(guide), target, valid)


@pytest.fixture(scope="module")
def cases() -> dict[tuple[int, int], tuple[Case, Prepared]]:
    return {size: (case := case_of(size), prepare(case, FACTORS)) for size in SIZES}


def random_point(steps: tuple[float, ...], seed: int) -> RelaxedSchedule:
    rng = np.random.default_rng(seed)
    kappa, lam = rng.uniform(0.02, 0.8, len(steps)), rng.uniform(0.05, 0.249, len(steps))
    fidelity = np.exp(rng.uniform(*np.log((0.01, 3.0)), len(steps)))
    free = [logit(4.0 * x) for x in lam]
    return RelaxedSchedule(*(jnp.asarray(x, jnp.float32) for x in (steps, np.log(kappa), free, np.log(fidelity))))


# ---- whole steps ----

COUNTS = (0, 1, 2, BLOCK_STEPS, BLOCK_STEPS + 1)
"""Few, and both sides of a block's end: the real cascade is compiled for each combination."""


step_vectors = st.tuples(*[st.sampled_from(COUNTS)] * 3).filter(any)


@pytest.mark.slow
@settings(max_examples=12)
@given(steps=step_vectors, seed=st.integers(0, 99), size=st.sampled_from(SIZES))
def test_with_whole_steps_it_is_the_real_cascade(
    cases: dict, steps: tuple[int, ...], seed: int, size: tuple[int, int]
) -> None:
    case, prepared = cases[size]
    point = random_point(steps, seed)
    want = np.asarray(refined_filter(case, point.schedule(FACTORS)))
    np.testing.assert_allclose(filter_of(prepared, point, FACTORS), want, rtol=2e-5, atol=2e-5)


def test_a_value_that_is_not_finite_counts_as_unknown() -> None:
    case = case_of(SIZES[0])
    broken = dataclasses.replace(case.shaded, illuminance=case.shaded.illuminance.at[12, 3, 0].set(jnp.nan))
    case, point = dataclasses.replace(case, shaded=broken), random_point((1, 2, 1), 0)
    want = np.asarray(refined_filter(case, point.schedule(FACTORS)))
    np.testing.assert_allclose(filter_of(prepare(case, FACTORS), point, FACTORS), want, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("size", SIZES[1:])
@pytest.mark.parametrize(
    "steps", [(0, 2, 3), (2, 0, 3), (2, 3, 0), (0, 0, 2), (0, 2, 0), (2, 0, 0), (3, 2, 1), (MOST_STEPS, 0, 0)]
)
def test_levels_may_vanish_anywhere(cases: dict, size: tuple[int, int], steps: tuple[int, ...]) -> None:
    case, prepared = cases[size]
    point = random_point(steps, 7)
    want = np.asarray(refined_filter(case, point.schedule(FACTORS)))
    np.testing.assert_allclose(filter_of(prepared, point, FACTORS), want, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("fidelity", FIDELITY_RANGE)
def test_the_data_term_is_the_real_one_at_the_ends_of_its_range(cases: dict, fidelity: float) -> None:
    case, prepared = cases[SIZES[1]]
    point = dataclasses.replace(random_point((3, 2, 1), 7), log_fidelity=jnp.full(3, np.log(fidelity)))
    want = np.asarray(refined_filter(case, point.schedule(FACTORS)))
    np.testing.assert_allclose(filter_of(prepared, point, FACTORS), want, rtol=2e-5, atol=2e-5)


def test_without_fidelity_it_is_the_cascade_without_a_data_term(cases: dict) -> None:
    case, prepared = cases[SIZES[1]]
    point = dataclasses.replace(random_point((3, 2, 1), 7), log_fidelity=jnp.full(3, -jnp.inf))
    schedule = point.schedule(FACTORS)
    free = dataclasses.replace(
        schedule, levels=tuple(dataclasses.replace(level, fidelity=None) for level in schedule.levels)
    )
    want = np.asarray(refined_filter(case, free))
    np.testing.assert_allclose(filter_of(prepared, point, FACTORS), want, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("level", range(3))
def test_each_level_holds_on_by_its_own_fidelity(cases: dict, level: int) -> None:
    _, prepared = cases[SIZES[0]]
    point = random_point((3, 2, 1), 3)
    more = dataclasses.replace(point, log_fidelity=point.log_fidelity.at[level].add(1.0))
    change = jnp.abs(filter_of(prepared, more, FACTORS) - filter_of(prepared, point, FACTORS))
    assert float(change.max()) > 1e-3
    without = dataclasses.replace(point, steps=point.steps.at[level].set(0.0))
    more = dataclasses.replace(more, steps=without.steps)
    np.testing.assert_array_equal(filter_of(prepared, more, FACTORS), filter_of(prepared, without, FACTORS))


@pytest.mark.parametrize("steps", [(1, 0), (0, 1)])
def test_the_mean_in_far_holes_is_the_real_one(steps: tuple[int, int]) -> None:
    """Far from anything known, in a picture of which the factors leave cut-off cells, and those the brightest."""
    size, factors = (33, 41), (16, 8)
    case = case_of(size)
    rows = jnp.arange(size[0])[:, None, None]
    known = jnp.broadcast_to(rows >= 24, (*size, 1))
    illuminance = jnp.where(rows == 32, 4000.0, case.shaded.illuminance)
    shaded = dataclasses.replace(case.shaded, confidence=known.astype(float), illuminance=illuminance)
    case = dataclasses.replace(case, shaded=shaded)
    point = RelaxedSchedule.of(steps, kappa=0.3)
    want = np.asarray(refined_filter(case, point.schedule(factors)))
    np.testing.assert_allclose(filter_of(prepare(case, factors), point, factors), want, rtol=1e-4)


def test_without_holes_the_weights_do_nothing() -> None:
    """Of two lights of which one is dark, the other alone makes the filter; the sum of both is linear in lights."""
    case = case_of((16, 24), holes=False)
    prepared = prepare(case, FACTORS)
    point = random_point((1.5, 0.3, 2.7), 2)
    both = np.asarray(filter_of(prepared, point, FACTORS))
    parts = []
    for k in range(2):
        colors, *rest = prepared.picture
        one = jnp.zeros_like(colors).at[k].set(colors[k])
        parts.append(filter_of(dataclasses.replace(prepared, picture=(one, *rest)), point, FACTORS))
    np.testing.assert_allclose(parts[0] + parts[1], both, rtol=1e-5)


# ---- between whole steps ----

NEAR = 1e-3


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("count", [1, 2, BLOCK_STEPS, BLOCK_STEPS + 1])
def test_continuous_at_whole_steps(cases: dict, level: int, count: int) -> None:
    """From both sides; 1 is where a level is fully there, multiples of BLOCK where another block is entered."""
    _, prepared = cases[SIZES[0]]
    for others in (0.0, 0.4, 3.0):
        steps = [others] * 3
        steps[level] = count
        middle = filter_of(prepared, random_point(tuple(steps), 3), FACTORS)
        for side in (-1, 1):
            steps[level] = count + side * NEAR
            beside = filter_of(prepared, random_point(tuple(steps), 3), FACTORS)
            assert 0 < float(jnp.abs(beside - middle).max()) < 20 * NEAR


@pytest.mark.parametrize("level", range(3))
@pytest.mark.parametrize("others", [0.0, 0.4, 3.0])
def test_a_level_appears_without_a_jump(cases: dict, level: int, others: float) -> None:
    """Steep where it is the first to reach into a hole, so the change must vanish with n rather than be small."""
    _, prepared = cases[SIZES[0]]

    def filter_with(n: float) -> jax.Array:
        steps = [others] * 3
        steps[level] = n
        return filter_of(prepared, random_point(tuple(steps), 3), FACTORS)

    without = filter_with(0.0)
    changes = [float(jnp.abs(filter_with(n) - without).max()) for n in (0.1, 1e-2, 1e-4, 1e-6)]
    assert changes[0] > 1e-6, changes
    assert np.all(np.diff(changes[:3]) < 0) and changes[2] < 0.03 and changes[3] < 5e-4, changes
    assert changes[3] < 0.0125 * changes[2] + 2e-6, "in proportion to n, once that is small against HOLE_FLOOR"
    assert float(jnp.abs(filter_with(1e-30) - without).max()) < 1e-6, "divided by what is left"


def test_without_any_steps_it_is_the_picture_itself(cases: dict) -> None:
    case, prepared = cases[SIZES[0]]
    got = np.asarray(filter_of(prepared, random_point((0.0, 0.0, 0.0), 0), FACTORS))
    raw, known = raw_filter(case.shaded), np.asarray(case.shaded.confidence)[..., 0] > 0
    np.testing.assert_allclose(got[known], raw[known], rtol=1e-5)
    assert np.isfinite(got).all()


# ---- loss and gradients ----

SHORT = (4, 1)
FREE = (2.3, 3.6)


@pytest.fixture(scope="module")
def fine() -> tuple[Case, Prepared]:
    """In float64, and small: the gradient takes seconds to compile."""

    def double(x: jax.Array) -> jax.Array:
        return x.astype(jnp.float64) if x.dtype == jnp.float32 else x

    with jax.enable_x64(True):
        case = jax.tree.map(double, case_of((9, 12), seed=4, lights=1))
        return case, prepare(case, SHORT)


def double_plan(steps: tuple[float, ...], seed: int) -> RelaxedSchedule:
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), random_point(steps, seed))


def test_the_loss_is_the_one_of_the_real_filter(fine: tuple[Case, Prepared]) -> None:
    case, prepared = fine
    with jax.enable_x64(True):
        point = double_plan((2, 1), 1)
        real = refined_filter(case, point.schedule(SHORT))
        want = filter_loss(real, case.target, case.frame, case.valid)
        for loss in (evaluate(point, prepared, SHORT), evaluate_with_gradient(point, prepared, SHORT)[0]):
            np.testing.assert_allclose(loss, want, rtol=1e-5)


@pytest.mark.parametrize("steps", [FREE, (0.4, 2.5), (0.7, 0.2), (BLOCK_STEPS + 0.5, 1.5)])
def test_gradients_are_the_differences(fine: tuple[Case, Prepared], steps: tuple[float, ...]) -> None:
    """Every entry: steps between whole numbers (of levels half there, too), log κ, logit λ, log α."""
    _, prepared = fine
    with jax.enable_x64(True):
        point = double_plan(steps, 5)
        _, slope = evaluate_with_gradient(point, prepared, SHORT)
        leaves, structure = jax.tree.flatten(point)
        assert len(leaves) == 4
        for index, leaf in enumerate(leaves):
            for entry in range(len(SHORT)):

                def at(shift: float, index: int = index, entry: int = entry, leaf: jax.Array = leaf) -> float:
                    moved = [*leaves]
                    moved[index] = leaf.at[entry].add(shift)
                    return float(evaluate(jax.tree.unflatten(structure, moved), prepared, SHORT))

                numeric = (at(1e-5) - at(-1e-5)) / 2e-5
                got = float(jax.tree.leaves(slope)[index][entry])
                assert got != 0
                np.testing.assert_allclose(got, numeric, rtol=1e-5, atol=1e-9, err_msg=f"leaf {index}[{entry}]")


def test_an_absent_level_has_no_infinite_gradient(fine: tuple[Case, Prepared]) -> None:
    _, prepared = fine
    with jax.enable_x64(True):
        for steps in ((0.0, 0.0), (0.0, 2.0), (2.0, 0.0), (0.0, MOST_STEPS), (1.0, 1.0)):
            value, slope = evaluate_with_gradient(double_plan(steps, 5), prepared, SHORT)
            assert all(np.isfinite(x).all() for x in (value, *jax.tree.leaves(slope)))


def test_one_compilation_serves_all_step_counts(fine: tuple[Case, Prepared]) -> None:
    _, prepared = fine
    with jax.enable_x64(True):
        for function in (evaluate, evaluate_with_gradient):
            function(double_plan(FREE, 1), prepared, SHORT)
            before = function._cache_size()
            for steps in ((1.0, 2.0), (0.0, 1.0), (0.2, 40.0), (MOST_STEPS, 0.5)):
                function(double_plan(steps, 2), prepared, SHORT)
            assert function._cache_size() == before


# ---- points ----


@given(
    values=st.lists(st.floats(-30, 30, width=32), min_size=3, max_size=3),
    logs=st.lists(st.floats(-20, 20, width=32), min_size=3, max_size=3),
)
def test_kappa_lambda_and_alpha_stay_in_range(values: list[float], logs: list[float]) -> None:
    free = jnp.asarray(logs, jnp.float32)
    point = RelaxedSchedule(jnp.ones(3), free, jnp.asarray(values, jnp.float32), free[::-1])
    for positive in (point.kappa, point.fidelity):
        assert np.all(positive > 0) and np.all(np.isfinite(positive))
    assert np.all(point.lam >= 0) and np.all(point.lam <= 0.25)
    inside = np.abs(values) < 10
    assert np.all(np.asarray(point.lam)[inside] > 0) and np.all(np.asarray(point.lam)[inside] < 0.25)


def test_plan_of() -> None:
    point = RelaxedSchedule.of([1, 2.5, 0], kappa=[0.1, 0.2, 0.3], lam=0.2, fidelity=[0.4, 0.5, 6.0])
    np.testing.assert_allclose(point.steps, [1, 2.5, 0])
    np.testing.assert_allclose(point.kappa, [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(point.lam, 0.2, rtol=1e-6)
    np.testing.assert_allclose(point.fidelity, [0.4, 0.5, 6.0], rtol=1e-6)
    usual = RelaxedSchedule.of([1, 1])
    np.testing.assert_allclose(usual.kappa, GUIDED_KAPPA, rtol=1e-6)
    np.testing.assert_allclose(usual.lam, DEFAULT_LAM, rtol=1e-6)
    np.testing.assert_allclose(usual.fidelity, GUIDED_FIDELITY, rtol=1e-6)
    assert {leaf.dtype for leaf in jax.tree.leaves(point)} == {jnp.dtype("float32")}


def test_a_plan_as_it_is_by_default_is_the_preset() -> None:
    """Its steps, in its form, at its κ, λ and α: no tuning run ends worse than the preset `hyjax`."""
    preset = Schedule.preset("hyjax")
    steps = {level.factor: level.steps for level in preset.levels}
    factors = (32, 16, 8, 4, 2, 1)
    got = RelaxedSchedule.of([steps.get(factor, 0) for factor in factors]).schedule(factors)
    assert (got.pooling, got.upsampling, got.norm) == (preset.pooling, preset.upsampling, preset.norm)
    for ours, theirs in zip(got.levels, preset.levels, strict=True):
        assert ours.factor == theirs.factor
        np.testing.assert_allclose(ours.step_sizes, theirs.step_sizes, rtol=1e-6)
        np.testing.assert_allclose([ours.kappa, ours.fidelity], [theirs.kappa, theirs.fidelity], rtol=1e-6)


def test_a_schedule_leaves_out_empty_levels() -> None:
    point = RelaxedSchedule.of([0.4, 2.6, 0, 1], kappa=[0.1, 0.2, 0.3, 0.4], lam=0.2, fidelity=[1, 2, 3, 4])
    schedule = point.schedule((8, 4, 2, 1), "mine")
    assert schedule.name == "mine"
    assert (schedule.pooling, schedule.upsampling, schedule.norm) == ("guide", "guide", "l2")
    assert [(level.factor, level.steps) for level in schedule.levels] == [(4, 3), (1, 1)]
    np.testing.assert_allclose([level.kappa for level in schedule.levels], [0.2, 0.4], rtol=1e-6)
    np.testing.assert_allclose([level.fidelity for level in schedule.levels], [2, 4], rtol=1e-6)
    for level in schedule.levels:
        np.testing.assert_allclose(level.step_sizes, 0.2, rtol=1e-6)


def test_a_schedule_of_a_plan_survives_json() -> None:
    schedule = random_point((3, 0, 2), 9).schedule(FACTORS)
    again = type(schedule).from_json(schedule.to_json())
    assert again.to_json() == schedule.to_json() and again.upsampling == "guide"
    for one, other in zip(again.levels, schedule.levels, strict=True):
        assert (one.factor, one.kappa, one.fidelity) == (other.factor, other.kappa, other.fidelity)
        np.testing.assert_array_equal(one.step_sizes, other.step_sizes)


@pytest.mark.parametrize("steps", [(0, 0), (0.4, 0.2)])
def test_a_plan_without_steps_is_no_schedule(steps: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="needs at least one level"):
        RelaxedSchedule.of(steps).schedule((2, 1))


class Valley(Objective):
    """Rosenbrock's valley in the log κ of two levels, which takes many steps."""

    def __init__(self) -> None:
        super().__init__((), FACTORS[:2])
        object.__setattr__(self, "asked", [0])

    def __call__(self, point: RelaxedSchedule) -> float:
        a, b = np.asarray(point.log_kappa, float) + 2.0
        return float(1e-2 * (b - a * a) ** 2 + 1e-4 * (1 - a) ** 2)

    def gradient(self, point: RelaxedSchedule, frames: Any = None) -> tuple[float, RelaxedSchedule]:
        self.asked[0] += 1
        a, b = np.asarray(point.log_kappa, float) + 2.0
        slope = np.array([-4e-2 * a * (b - a * a) - 2e-4 * (1 - a), 2e-2 * (b - a * a)])
        return self(point), dataclasses.replace(jax.tree.map(np.zeros_like, point), log_kappa=slope)


def test_numbers_are_refined_until_the_time_is_over() -> None:
    start = RelaxedSchedule.of((8, 4))
    whole, cut = Valley(), Valley()
    best, early = polish(whole, start, 30), polish(cut, start, 30, lambda: cut.asked[0] > 2)
    assert whole.asked[0] > cut.asked[0] and 3 <= cut.asked[0] <= 8
    assert best.loss < early.loss <= whole(start)
