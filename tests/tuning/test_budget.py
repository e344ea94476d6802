"""Step counts inside a budget: the projection is the nearest, the lists are complete, nothing exceeds it."""

import itertools

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from hyjax.tuning.budget import MOST_STEPS, Steps, fill, fits, moves, neighbours, project, single_steps
from hyjax.tuning.cost_model import CostModel

SIZE = 3
BUDGET = 10.0

costs = st.floats(0.0, 4.0, width=32)
per_steps = st.floats(0.015625, 2.0, width=32)


def triples(values: st.SearchStrategy[float]) -> st.SearchStrategy[tuple]:
    return st.tuples(*[values] * SIZE)


models = st.builds(
    CostModel,
    fixed=st.floats(0.0, 3.0, width=32),
    level=triples(costs),
    step=triples(per_steps),
    finest=triples(costs),
)
real_steps = triples(st.floats(0.0, 90.0, width=32)).map(lambda n: np.array(n, np.float32))
whole_steps = triples(st.integers(0, 30))


def cost_of(steps: np.ndarray, cost: CostModel) -> float:
    return cost(steps.tolist()) if steps.any() else 0.0


# ---- projection ----


@settings(max_examples=200, phases=[Phase.generate])
@given(steps=real_steps, cost=models)
def test_a_projection_fits(steps: np.ndarray, cost: CostModel) -> None:
    got = project(steps, cost, BUDGET)
    assert got.dtype == np.float32 and got.shape == steps.shape
    assert cost_of(got, cost) <= BUDGET * (1 + 1e-4)
    assert np.all((got == 0) | ((got >= 0.5) & (got <= MOST_STEPS)))
    assert np.all(got <= np.minimum(steps, MOST_STEPS) * (1 + 1e-4)), "no level ever needs more steps to fit"


@settings(max_examples=200)
@given(steps=real_steps, cost=models)
def test_what_fits_stays(steps: np.ndarray, cost: CostModel) -> None:
    once = project(steps, cost, BUDGET)
    np.testing.assert_allclose(project(once, cost, BUDGET), once, rtol=1e-4)
    small = np.where(steps < 0.5, 0.0, np.minimum(steps / 8, MOST_STEPS)).astype(np.float32)
    small[small < 0.5] = 0.0
    if cost_of(small, cost) <= BUDGET:
        np.testing.assert_array_equal(project(small, cost, BUDGET), small)


@settings(max_examples=200)
@given(steps=real_steps, cost=models)
def test_levels_give_up_the_same_part_and_no_more_than_needed(steps: np.ndarray, cost: CostModel) -> None:
    got = project(steps, cost, BUDGET)
    there = got > 0
    kept = np.where(there, np.minimum(steps, MOST_STEPS), 0.0)
    if there.any() and cost(kept.tolist()) > BUDGET:
        parts = got[there] / kept[there]
        np.testing.assert_allclose(parts, parts[0], rtol=1e-4)
        np.testing.assert_allclose(cost(got.tolist()), BUDGET, rtol=1e-4)
    else:
        np.testing.assert_allclose(got, kept, rtol=1e-6)


def test_nearest_in_relative_entropy() -> None:
    """Among all points of a fine grid that fit."""
    cost = CostModel(1.0, (0.5, 1.0), (0.25, 0.5), (0.5, 0.0))
    steps, step = np.array([20.0, 14.0], np.float32), np.array([0.25, 0.5])
    grid = np.stack(np.meshgrid(np.arange(0.5, 40, 0.05), np.arange(0.5, 40, 0.05)), -1).reshape(-1, 2)
    inside = grid[1.0 + 1.5 + grid @ step <= BUDGET]
    spent, wanted = inside * step, steps * step
    entropy = (spent * np.log(spent / wanted) - spent + wanted).sum(-1)
    np.testing.assert_allclose(project(steps, cost, BUDGET), inside[np.argmin(entropy)], atol=0.1)


def test_room_for_exactly_half_a_step() -> None:
    cost = CostModel(1.0, (4.0,), (2.0,), (4.0,))
    got = project(np.array([1.0], np.float32), cost, BUDGET)
    assert got[0] in (0.0, 0.5)


@pytest.mark.parametrize("budget", [3.5, 5.0])
def test_the_papers_schedule_keeps_coarse_levels_and_uses_the_time(budget: float) -> None:
    """On about what 512x512 costs on two cores, where 64 steps at 1/32 are a few percent of the time."""
    step = (0.002, 0.003, 0.004, 0.016, 0.076, 0.34)
    cost = CostModel(1.2, (0.5, 0.3, 0.5, 0.5, 0.8, 1.0), step, (3.5, 0.4, 0.3, 0.1, 0.2, 0.0))
    got = project(np.array([0, 10, 15, 25, 30, 0], np.float32), cost, budget)
    assert np.count_nonzero(got) > 1
    assert 0.9 * budget < cost(got.tolist()) <= budget * (1 + 1e-4)


def test_a_level_with_less_than_half_a_step_goes_with_all_it_costs() -> None:
    cost = CostModel(1.0, (4.0, 0.0), (1.0, 1.0), (0.0, 0.0))
    np.testing.assert_array_equal(project(np.array([0.4, 9.0], np.float32), cost, BUDGET), [0.0, 9.0])


def test_the_smallest_level_goes_first() -> None:
    cost = CostModel(1.0, (3.0, 3.0, 3.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    got = project(np.array([10.0, 5.0, 20.0], np.float32), cost, BUDGET)
    np.testing.assert_array_equal(got, [10.0, 0.0, 20.0])  # exactly the budget


@pytest.mark.parametrize("steps", [(0.0, 0.0, 0.0), (0.4, 0.1, 0.3)])
def test_nothing_stays_nothing(steps: tuple[float, ...]) -> None:
    cost = CostModel(1.0, (0.0,) * 3, (1.0,) * 3, (0.0,) * 3)
    np.testing.assert_array_equal(project(np.array(steps, np.float32), cost, BUDGET), 0.0)


def test_nothing_fits() -> None:
    cost = CostModel(11.0, (0.0,) * 3, (1.0,) * 3, (0.0,) * 3)
    np.testing.assert_array_equal(project(np.array([9.0, 1.0, 64.0], np.float32), cost, BUDGET), 0.0)


def test_steps_that_cost_nothing() -> None:
    """A fitted model may have such."""
    cost = CostModel(1.0, (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))
    got = project(np.array([500.0, 30.0], np.float32), cost, BUDGET)
    assert np.all(got > 0) and got.max() <= MOST_STEPS and cost(got.tolist()) <= BUDGET * (1 + 1e-4)
    free = CostModel(9.0, (4.0, 1.0), (0.0, 0.0), (0.0, 0.0))
    np.testing.assert_array_equal(project(np.array([5.0, 30.0], np.float32), free, BUDGET), [0.0, 30.0])


def test_time_that_a_dropped_level_frees_goes_to_the_others() -> None:
    """The first level is left with less than half a step; without its 6 ms the other loses but one."""
    cost = CostModel(0.0, (6.0, 0.0), (1.0, 1.0), (0.0, 0.0))
    got = project(np.array([1.0, 11.0], np.float32), cost, BUDGET)
    np.testing.assert_allclose(got, [0.0, 10.0], rtol=1e-3)


# ---- whole steps ----


@given(steps=whole_steps, cost=models)
def test_fits(steps: Steps, cost: CostModel) -> None:
    assert fits(steps, cost, BUDGET) == (any(steps) and cost(steps) <= BUDGET)


def test_fits_knows_the_most_steps_and_the_exact_budget() -> None:
    cost = CostModel(1.0, (0.0,), (0.125,), (0.0,))
    assert fits((MOST_STEPS,), cost, 9.0) and not fits((MOST_STEPS,), cost, 8.999)
    assert not fits((MOST_STEPS + 1,), cost, 1e9) and not fits((0,), cost, 1e9)


def test_single_steps() -> None:
    assert single_steps(3) == [(1, 0, 0), (0, 1, 0), (0, 0, 1)]


@settings(max_examples=60)
@given(real=triples(st.sampled_from([0.0, 0.5, 0.7, 1.0, 1.4, 5.0, 9.9, 63.5, 64.0])), cost=models)
def test_neighbours_are_all_within_reach(real: tuple[float, ...], cost: CostModel) -> None:
    def reach(n: float) -> set[int]:
        low, high = int(np.floor(n)), int(np.ceil(n))
        return {k for k in range(low - 1, high + 2) if 0 <= k <= MOST_STEPS} if n else {0}

    reaches = [reach(n) for n in real]
    inside = {steps for steps in itertools.product(*reaches) if any(steps) and cost(steps) <= BUDGET}

    got = neighbours(np.array(real, np.float32), cost, BUDGET)
    assert len(got) == len(set(got)) and set(got) == inside


@given(steps=whole_steps, cost=models, order=st.permutations(range(SIZE)), count=st.integers(0, SIZE))
def test_fill_spends_what_is_left(steps: Steps, cost: CostModel, order: list[int], count: int) -> None:
    order = order[:count]
    got = fill(steps, cost, BUDGET, order)
    if not fits(steps, cost, BUDGET):
        assert got == steps
        return
    assert fits(got, cost, BUDGET)
    for level in range(SIZE):
        if level not in order or not steps[level]:
            assert got[level] == steps[level]
        else:
            assert got[level] >= steps[level]
            assert not fits(tuple(n + (k == level) for k, n in enumerate(got)), cost, BUDGET)


def test_fill_goes_in_order_and_stops_at_the_most() -> None:
    cost = CostModel(0.0, (0.0, 0.0), (1.0, 1.0), (0.0, 0.0))
    assert fill((1, 1), cost, BUDGET, (1, 0)) == (1, 9)
    assert fill((1, 1), cost, BUDGET, (0, 1)) == (9, 1)
    assert fill((1, 1), cost, 1000.0, (0,)) == (MOST_STEPS, 1)


@given(steps=whole_steps, cost=models)
def test_moves_fit_and_differ(steps: Steps, cost: CostModel) -> None:
    got = moves(steps, cost, BUDGET)
    assert len(got) == len(set(got)) and steps not in got
    assert all(fits(other, cost, BUDGET) for other in got)
    for level in range(SIZE):
        for change in (-2, -1, 1, 2):
            near = tuple(n + change * (k == level) for k, n in enumerate(steps))
            if near[level] >= 0 and fits(near, cost, BUDGET):
                assert near in got


def test_moves_let_another_level_pay() -> None:
    cost = CostModel(0.0, (1.0, 1.0), (1.0, 2.0), (0.0, 0.0))
    got = moves((4, 2), cost, BUDGET)  # exactly the budget
    assert (2, 3) in got, "one step more below for two above"
    assert (6, 1) in got, "a step fewer below, filled up above"
    assert (9, 0) in got, "a level given up, filled up above"
    assert (0, 4) in got
    new = moves((9, 0), cost, BUDGET)  # exactly the budget, too
    assert (6, 1) in new, "a level that was not there, paid by the other"
