"""The search on an objective of which the optimum is known, and which costs nothing to evaluate."""

import dataclasses
import itertools
import json
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.tuning.budget import Steps, fits, project
from hyjax.tuning.descent import (
    Objective,
    bounded,
    bounds,
    polish,
    promising,
    relax,
    starts,
    whole,
    with_steps,
)
from hyjax.tuning.latency_table import CostModel
from hyjax.tuning.relaxation import FIDELITY_RANGE, KAPPA_RANGE, LAM_RANGE, RelaxedSchedule, logit
from hyjax.tuning.search import AGAIN, QUICK, Effort, Search

COST = CostModel(1.0, (0.3, 0.4, 0.6), (0.1, 0.2, 0.5), (0.8, 0.2, 0.0))
BUDGET = 8.0
KAPPA, LOGIT, FIDELITY = float(np.log(0.02)), 1.0, float(np.log(0.3))  # where they are best
GAIN, HALF = np.array([0.03, 0.04, 0.02], np.float32), np.array([12.0, 5.0, 2.5], np.float32)
FAST = Effort(sampled=8, relaxed=2, iterations=20, rounded=12, polished=2, polishing=8, descents=2)


@jax.jit
def bowl(point: RelaxedSchedule, frame: jax.Array) -> jax.Array:
    """Each level repairs its share, less and less with every step, and costs for κ, λ and α beside the best."""
    present = jnp.clip(point.steps, 0.0, 1.0)
    left = jnp.sum(GAIN * jnp.exp(-point.steps / HALF))
    beside = (point.log_kappa - KAPPA) ** 2 + 0.3 * (point.logit_lam - LOGIT) ** 2
    beside += 0.5 * (point.log_fidelity - FIDELITY) ** 2
    return left + 1e-3 * jnp.sum(present * beside) + 1e-4 * frame * jnp.sum(point.steps / (1.0 + point.steps))


slope_of = jax.jit(jax.value_and_grad(bowl))


@dataclasses.dataclass(frozen=True)
class Bowl(Objective):
    """Two frames that pull in opposite directions."""

    calls: dict[str, int] = dataclasses.field(default_factory=lambda: {"loss": 0, "gradient": 0})

    def __call__(self, point: RelaxedSchedule) -> float:
        self.calls["loss"] += 1
        return float(np.mean([bowl(point, frame) for frame in self.prepared]))

    def gradient(
        self, point: RelaxedSchedule, frames: Iterable[int] | None = None
    ) -> tuple[float, RelaxedSchedule]:
        self.calls["gradient"] += 1
        chosen = range(len(self.prepared)) if frames is None else list(frames)
        return jax.tree.map(lambda *x: np.mean(x, axis=0), *(slope_of(point, self.prepared[i]) for i in chosen))


def bowl_objective() -> Bowl:
    return Bowl([jnp.float32(1.0), jnp.float32(-1.0)], (4, 2, 1))


def best_by_brute_force(budget: float, cost: CostModel = COST) -> tuple[float, Steps]:
    """Over all whole steps that fit, with the best κ, λ and α."""
    table = [np.exp(-np.arange(65) / half) * gain for half, gain in zip(HALF, GAIN)]
    all_steps = itertools.product(*(range(65) for _ in HALF))
    rough = np.array([1.0 / max(s, 1e-3) for s in cost.step])
    most = np.minimum(64, budget * rough)
    return min(
        (float(sum(t[n] for t, n in zip(table, steps))), steps)
        for steps in all_steps
        if all(n <= m for n, m in zip(steps, most)) and fits(steps, cost, budget)
    )


# ---- the whole of it ----


@pytest.mark.parametrize("budget", [2.5, 8.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_finds_the_best(budget: float, seed: int) -> None:
    found = Search(bowl_objective(), COST, seed=seed).run(budget)
    best, steps = best_by_brute_force(budget)
    assert found[0].loss <= 1.01 * best, (found[0].steps, steps)
    assert found[0].loss >= best * (1 - 1e-5), "better than possible: the objective was not asked"
    assert COST(found[0].steps) <= budget
    np.testing.assert_allclose(bowl_objective()(found[0].point), found[0].loss, rtol=1e-6)


@pytest.mark.parametrize("effort", [FAST, QUICK, AGAIN])
def test_all_it_returns_fits_and_is_in_order(effort: Effort) -> None:
    search = Search(bowl_objective(), COST)
    found = search.run(BUDGET, effort, warm=[RelaxedSchedule.of([30, 20, 10])])
    losses = [f.loss for f in found]
    assert losses == sorted(losses) and len({f.steps for f in found}) == len(found) > 1
    for f in found:
        assert fits(f.steps, COST, BUDGET)
        np.testing.assert_array_equal(np.asarray(f.point.steps), f.steps)
        there = np.array(f.steps) > 0
        own = f.point.log_kappa, f.point.logit_lam, f.point.log_fidelity
        for values, (low, high) in zip(own, bounds(), strict=True):
            assert np.all(np.asarray(values)[there] >= low - 1e-5)
            assert np.all(np.asarray(values)[there] <= high + 1e-5)


def test_same_seed_same_result() -> None:
    first, second = (Search(bowl_objective(), COST, seed=3).run(BUDGET, FAST) for _ in range(2))
    assert [f.steps for f in first] == [f.steps for f in second]
    for a, b in zip(first, second, strict=True):
        assert a.loss == b.loss
        jax.tree.map(np.testing.assert_array_equal, a.point, b.point)


def test_more_budget_is_never_worse() -> None:
    search = Search(bowl_objective(), COST)
    losses = [search.run(budget, FAST)[0].loss for budget in (2.0, 4.0, 8.0)]
    assert losses[0] > losses[1] > losses[2]


def test_earlier_finds_count_for_later_budgets() -> None:
    search = Search(bowl_objective(), COST)
    wide = search.run(BUDGET, FAST)
    narrow = search.run(4.0, FAST)
    assert {f.steps for f in wide if COST(f.steps) <= 4.0} <= {f.steps for f in narrow}
    assert search.ranked(BUDGET)[0].loss <= wide[0].loss


def test_time_is_up_at_once() -> None:
    objective = bowl_objective()
    found = Search(objective, COST, expired=lambda: True).run(BUDGET, FAST)
    assert found and all(fits(f.steps, COST, BUDGET) for f in found)
    assert objective.calls["loss"] <= 2 * (FAST.sampled + 3) + 3, "the starting points, and what is rounded"
    assert objective.calls["gradient"] <= 1


@pytest.mark.parametrize("after", [1, 5, 20])
def test_time_is_up_later(after: int) -> None:
    """Nothing is lost by it: what had been found is returned."""
    best, asked = [np.inf], [0]

    def expired() -> bool:
        asked[0] += 1
        return asked[0] > after

    def report(phase: str, loss: float) -> None:
        if phase != "relax":
            best[0] = min(best[0], loss)

    found = Search(bowl_objective(), COST, expired=expired, report=report).run(BUDGET, FAST)
    assert found and found[0].loss == best[0] and fits(found[0].steps, COST, BUDGET)


@pytest.mark.parametrize("warm", [[], [RelaxedSchedule.of([3, 3, 3])]])
def test_nothing_can_fit(warm: list[RelaxedSchedule]) -> None:
    objective = bowl_objective()
    assert Search(objective, COST).run(1.0, FAST, warm) == [] and objective.calls["loss"] == 0


@pytest.mark.parametrize("budget", [1.91, 2.11, 2.2])
def test_room_for_a_step_or_two(budget: float) -> None:
    found = Search(bowl_objective(), COST).run(budget, FAST)
    best, steps = best_by_brute_force(budget)
    assert found and all(fits(f.steps, COST, budget) for f in found)
    assert found[0].steps == steps and found[0].loss <= 1.02 * best


def test_warm_plans_are_used() -> None:
    """Brought within the budget; the best of them is what is relaxed, not a single step."""
    effort, asked = dataclasses.replace(AGAIN, descents=0), []

    def remember(key: str, compute: Callable[[], Any]) -> Any:
        asked.append(key)
        return compute()

    for steps, start in (((6, 6, 6), (6, 6, 6)), ((60, 60, 60), project(np.full(3, 60.0), COST, BUDGET))):
        Search(bowl_objective(), COST, remember=remember).run(BUDGET, effort, [RelaxedSchedule.of(steps)])
        relaxed = [key for key in asked if key.startswith("relax")]
        want = np.concatenate(jax.tree.leaves(RelaxedSchedule.of(start))).tobytes().hex()
        assert relaxed and relaxed[-1].endswith(want)
    assert Search(bowl_objective(), COST).run(BUDGET, effort, [RelaxedSchedule.of([0, 0, 0])]), (
        "an empty one is no obstacle"
    )


def test_reports_every_phase() -> None:
    seen: list[tuple[str, float]] = []
    found = Search(bowl_objective(), COST, report=lambda *entry: seen.append(entry)).run(BUDGET, FAST)
    assert {phase for phase, _ in seen} == {"start", "relax", "round", "polish", "descend"}
    assert min(loss for phase, loss in seen if phase != "relax") == found[0].loss


# ---- memory ----


class Memory:
    """As the journal: through JSON."""

    def __init__(self) -> None:
        self.text: dict[str, str] = {}
        self.keys: list[str] = []

    def __call__(self, key: str, compute: Callable[[], Any]) -> Any:
        self.keys.append(key)
        if key not in self.text:
            self.text[key] = json.dumps(compute())
        return json.loads(self.text[key])


def test_a_second_run_with_the_memory_of_the_first_does_nothing_again() -> None:
    memory, efforts = Memory(), dataclasses.replace(FAST, rounded=10_000)
    first = Search(bowl_objective(), COST, remember=memory).run(BUDGET, efforts)
    keys, memory.keys = memory.keys, []
    assert len(memory.text) == len(set(keys))
    objective = bowl_objective()
    second = Search(objective, COST, remember=memory).run(BUDGET, efforts)
    assert memory.keys == keys and objective.calls == {"loss": 0, "gradient": 0}
    assert [(f.steps, f.loss) for f in first] == [(f.steps, f.loss) for f in second]


@pytest.mark.parametrize("count", [3, 12, 40])
def test_a_run_broken_off_goes_on_to_the_same_end(count: int) -> None:
    want = Search(bowl_objective(), COST).run(BUDGET, FAST)
    memory, left = Memory(), [count]

    def report(phase: str, loss: float) -> None:
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Search(bowl_objective(), COST, remember=memory, report=report).run(BUDGET, FAST)
    before = len(memory.text)
    got = Search(bowl_objective(), COST, remember=memory).run(BUDGET, FAST)
    assert 0 < before < len(memory.text)
    assert [(f.steps, f.loss) for f in got] == [(f.steps, f.loss) for f in want]


def test_another_effort_budget_or_cost_is_another_key() -> None:
    memory = Memory()
    point = [RelaxedSchedule.of([4, 4, 4])]
    for effort in (AGAIN, dataclasses.replace(AGAIN, iterations=11)):
        for budget in (8.0, 9.0):
            for cost in (COST, dataclasses.replace(COST, fixed=1.1)):
                Search(bowl_objective(), cost, remember=memory).run(budget, effort, point)
    assert sum(key.startswith("relax") for key in memory.text) == 8


# ---- parts ----


def test_starts_fit_and_are_the_same_again() -> None:
    first, again, other = (starts(20, COST, BUDGET, seed) for seed in (5, 5, 6))

    def rows(points: list[RelaxedSchedule]) -> list[bytes]:
        return [np.concatenate([np.asarray(x) for x in jax.tree.leaves(point)]).tobytes() for point in points]

    assert rows(first) == rows(again) != rows(other)
    assert len(first) >= 13 and all(fits(whole(point), COST, BUDGET) for point in first)
    for point in first:
        np.testing.assert_array_equal(whole(point), point.steps)
        jax.tree.map(np.testing.assert_array_equal, bounded(point), point)
    assert len({tuple(n > 0 for n in whole(point)) for point in first}) >= 5, "different levels"
    assert len({float(point.log_kappa[0]) for point in first}) >= 3, "different κ"
    assert {whole(point) for point in starts(0, COST, BUDGET, 0)} == {(1, 0, 0), (0, 1, 0), (0, 0, 1)}
    assert starts(20, COST, 1.0, 0) == []


def test_relaxing_improves_and_stays_inside() -> None:
    objective, start = bowl_objective(), RelaxedSchedule.of([2, 2, 2], kappa=0.5, lam=0.05, fidelity=5.0)
    point = relax(objective, start, COST, BUDGET, 40, 0)
    assert objective(point) < 0.7 * objective(start)
    moved = [(getattr(point, name) - getattr(start, name)) for name in ("log_kappa", "logit_lam", "log_fidelity")]
    assert [np.sign(x).tolist() for x in moved] == [[-1] * 3, [1] * 3, [-1] * 3], "towards the best"
    assert COST(np.asarray(point.steps).tolist()) <= BUDGET * (1 + 1e-4)
    jax.tree.map(np.testing.assert_array_equal, bounded(point), point)
    again = relax(objective, start, COST, BUDGET, 40, 0)
    jax.tree.map(np.testing.assert_array_equal, point, again)


def test_relaxing_looks_at_one_frame_an_iteration() -> None:
    objective = bowl_objective()
    relax(objective, RelaxedSchedule.of([2, 2, 2]), COST, BUDGET, 7, 0)
    assert objective.calls == {"loss": 0, "gradient": 7}


@pytest.mark.parametrize("kappa", [KAPPA_RANGE[0], 0.02, KAPPA_RANGE[1]])
@pytest.mark.parametrize("lam", [0.011, 0.24, 0.2498])
@pytest.mark.parametrize("fidelity", [FIDELITY_RANGE[0], 0.1, FIDELITY_RANGE[1]])
def test_polishing_never_makes_worse_and_stays_inside(kappa: float, lam: float, fidelity: float) -> None:
    objective = bowl_objective()
    point = RelaxedSchedule.of([4, 0, 2], kappa=kappa, lam=lam, fidelity=fidelity)
    found = polish(objective, point, 10)
    assert found.loss <= objective(point) and found.steps == (4, 0, 2)
    assert found.loss == pytest.approx(objective(found.point), rel=1e-6)
    assert found.point.log_kappa[1] == point.log_kappa[1] and found.point.logit_lam[1] == point.logit_lam[1]
    assert found.point.log_fidelity[1] == point.log_fidelity[1]
    for values, (low, high) in ((found.point.kappa, KAPPA_RANGE), (found.point.fidelity, FIDELITY_RANGE)):
        assert np.all(np.asarray(values) >= low * (1 - 1e-5)) and np.all(np.asarray(values) <= high * (1 + 1e-5))
    assert np.all(np.asarray(found.point.lam) >= LAM_RANGE[0] * (1 - 1e-4))
    assert np.all(np.asarray(found.point.lam) <= LAM_RANGE[1] * (1 + 1e-4)) and np.all(found.point.lam < 0.25)
    np.testing.assert_allclose(np.asarray(found.point.log_kappa)[[0, 2]], KAPPA, atol=0.15)
    np.testing.assert_allclose(np.asarray(found.point.log_fidelity)[[0, 2]], FIDELITY, atol=0.3)


def test_polishing_ends_at_the_bounds() -> None:
    """An objective that wants ever larger κ and λ, and ever smaller α."""

    @dataclasses.dataclass(frozen=True)
    class Slope(Objective):
        def gradient(
            self, point: RelaxedSchedule, frames: Iterable[int] | None = None
        ) -> tuple[float, RelaxedSchedule]:
            ones = jnp.ones_like(point.steps)
            return self(point), RelaxedSchedule(ones, -0.01 * ones, -0.01 * ones, 0.01 * ones)

        def __call__(self, point: RelaxedSchedule) -> float:
            return float(1.0 - 0.01 * jnp.sum(point.log_kappa + point.logit_lam - point.log_fidelity))

    found = polish(Slope([], (2, 1)), RelaxedSchedule.of([1, 1]), 20)
    np.testing.assert_allclose(found.point.kappa, KAPPA_RANGE[1], rtol=1e-5)
    np.testing.assert_allclose(found.point.lam, LAM_RANGE[1], rtol=1e-5)
    np.testing.assert_allclose(found.point.fidelity, FIDELITY_RANGE[0], rtol=1e-5)


def test_promising_is_by_first_order() -> None:
    point = RelaxedSchedule.of([2.5, 3.5])
    slope = RelaxedSchedule(jnp.array([-1.0, -0.1]), *[jnp.zeros(2)] * 3)
    candidates = [(2, 5), (3, 3), (2, 3), (3, 4)]
    assert promising(candidates, point, slope, 9) == [(3, 4), (3, 3), (2, 5), (2, 3)]
    assert promising(candidates, point, slope, 2) == [(3, 4), (3, 3)]
    flat = dataclasses.replace(slope, steps=jnp.zeros(2))
    assert promising(candidates, point, flat, 9) == sorted(candidates), "ties in an order of their own"


def test_with_steps_takes_the_nearest_levels_values() -> None:
    columns = (start + jnp.arange(5.0) for start in (0.0, 10.0, 20.0))
    point = RelaxedSchedule(jnp.array([0.0, 2.0, 0.0, 0.0, 3.0]), *columns)
    got = with_steps(point, (1, 1, 1, 1, 1))
    np.testing.assert_array_equal(got.log_kappa, [1, 1, 1, 4, 4])
    np.testing.assert_array_equal(got.logit_lam, [11, 11, 11, 14, 14])
    np.testing.assert_array_equal(got.log_fidelity, [21, 21, 21, 24, 24])
    none = with_steps(dataclasses.replace(point, steps=jnp.zeros(5)), (1, 0, 0, 0, 0))
    np.testing.assert_array_equal(none.log_kappa, point.log_kappa)
    np.testing.assert_array_equal(none.log_fidelity, point.log_fidelity)


def test_whole_and_bounds() -> None:
    assert whole(RelaxedSchedule.of([0.4, 0.6, 7.2])) == (0, 1, 7)
    low_high, high_low = jnp.array([-99.0, 99.0]), jnp.array([99.0, -99.0])
    outside = RelaxedSchedule(jnp.ones(2), low_high, high_low, low_high)
    inside = bounded(outside)
    np.testing.assert_allclose(inside.kappa, KAPPA_RANGE, rtol=1e-5)
    np.testing.assert_allclose(inside.lam, LAM_RANGE[::-1], rtol=1e-5)
    np.testing.assert_allclose(inside.fidelity, FIDELITY_RANGE, rtol=1e-5)
    assert np.all(inside.lam < 0.25)
    kappa, lam, fidelity = bounds()
    assert lam == pytest.approx([logit(4 * x) for x in LAM_RANGE])
    assert kappa == pytest.approx(np.log(KAPPA_RANGE)) and fidelity == pytest.approx(np.log(FIDELITY_RANGE))
