"""The search, on a loss and a time that are known for all choices."""

import dataclasses
import functools
import itertools
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from hyjax.tuning.search import State, init, propose, search, update, within
from hyjax.tuning.space import Choices, Parameter, Space, key_of
from hyjax.tuning.surrogate import Surrogate
from hyjax.tuning.trial import Trial, front_of_trials

SPACE = Space(
    (
        Parameter("scale", (1, 2, 3, 4), 1, ordered=True),
        Parameter("cascade", tuple("abcdefgh"), "a"),
        Parameter("shadows", ("soft", "hard", "none"), "soft"),
        Parameter("guide", ("rgb", "none", "small"), "rgb"),
        Parameter("bounces", (True, False), True),
        Parameter("size", (1, 2), 1, active=lambda choices: choices["guide"] == "small"),
        Parameter("kappa", (0.01, 1.0), 0.1, continuous=True),
        Parameter("level_8", (0, 1, 2, 4, 6, 8), 4, ordered=True, cascade="level", factor=8),
    )
)
LOSS: dict[str, dict[Any, float]] = {
    "scale": {1: 0.0, 2: 0.04, 3: 0.11, 4: 0.2},
    "cascade": dict(zip("abcdefgh", (0.0, -0.06, 0.1, -0.02, 0.05, -0.05, 0.2, -0.12), strict=True)),
    "shadows": {"soft": 0.0, "hard": 0.02, "none": 0.12},
    "guide": {"rgb": 0.0, "none": 0.15, "small": -0.08},
    "bounces": {True: 0.0, False: 0.05},
    "size": {1: 0.0, 2: -0.02},
}
TIME: dict[str, dict[Any, float]] = {
    "scale": {1: 0.0, 2: -0.7, 3: -0.9, 4: -1.0},
    "cascade": dict(zip("abcdefgh", (0.0, 0.1, -0.2, 0.05, -0.1, 0.3, -0.3, 0.9), strict=True)),
    "shadows": {"soft": 0.0, "hard": -0.2, "none": -0.35},
    "guide": {"rgb": 0.0, "none": -0.05, "small": 0.6},
    "bounces": {True: 0.0, False: -0.15},
    "size": {1: 0.0, 2: 0.1},
}


def true_loss(choices: Choices) -> float:
    """Additive, but that `h` is worth nothing at a small scale; κ is best at 0.2, and 6 steps."""
    total = sum(LOSS[name][value] for name, value in choices.items() if name in LOSS)
    total += 0.02 * (abs(math.log((1 + choices["level_8"]) / 7)) - math.log(7 / 5))
    total += 0.12 * (choices["cascade"] == "h" and choices["scale"] > 1)
    return math.exp(total + 0.03 * math.log(choices["kappa"] / 0.2) ** 2 - 0.03 * math.log(0.1 / 0.2) ** 2)


def true_time(choices: Choices) -> float:
    return math.exp(sum(TIME[name][value] for name, value in choices.items() if name in TIME))


class Known:
    """Judge that knows, with cases that differ a little; it counts what it is asked."""

    def __init__(self, noise: float = 0.02) -> None:
        self.noise, self.asked = noise, Counter[str]()
        self.judged: dict[str, tuple[float, ...]] = {}

    def __call__(self, trial: Trial) -> Trial:
        choices = trial.choices
        if trial.improve:
            choices = choices | {"kappa": 0.2} | ({"level_8": 6} if trial.improve == "relaxed" else {})
        known = self.judged.get(key_of(choices), ())
        more = self.losses(choices, len(known), max(trial.cases, len(known)))
        self.judged[key_of(choices)] = known + more
        return dataclasses.replace(trial, choices=choices, losses=known + more, time=true_time(choices))

    def losses(self, choices: Choices, first: int, last: int) -> tuple[float, ...]:
        self.asked[key_of(choices)] += last - first
        seeds = (sum(map(ord, f"{key_of(choices)} {case}")) for case in range(first, last))
        return tuple(
            true_loss(choices) * math.exp(self.noise * np.random.default_rng(seed).standard_normal())
            if choices != SPACE.default
            else 1.0
            for seed in seeds
        )


def best_of_all(budget: float) -> float:
    """Least loss of all choices within a budget, at the best κ."""
    discrete = [p for p in SPACE.parameters if not p.continuous and not p.factor]
    all_of_them = itertools.product(*(p.values for p in discrete))
    whole = [
        SPACE.complete(dict(zip((p.name for p in discrete), values, strict=True)) | {"kappa": 0.2, "level_8": 6})
        for values in all_of_them
    ]
    return min(true_loss(choices) for choices in whole if true_time(choices) <= budget)


def begun(count: int = 40, seed: int = 0, **options: Any) -> State:
    return init(SPACE, [4, 8, 16], count, seed=seed, **options)


def search_anew(budgets: tuple[float, ...], count: int = 40, seed: int = 0, **options: Any) -> State:
    return search(begun(count, seed), Known(), budgets, **options)


searched = functools.cache(search_anew)


@pytest.mark.slow
@pytest.mark.parametrize("budget", [0.3, 0.5, math.inf])
def test_the_best_is_found(budget: float) -> None:
    """40 of 1 152 combinations, for one budget: within 3 % of the best loss, and never over the budget."""
    found = searched((budget,), 40, 0)
    best = found.best(budget, cases=16)
    assert best is not None and best.time is not None and best.time <= budget
    assert len(found.trials) <= 40
    assert true_loss(best.choices) <= 1.03 * best_of_all(budget)
    assert true_loss(best.choices) < 1 or budget < 0.6


@pytest.mark.slow
def test_several_budgets_share_the_trials() -> None:
    budgets = (0.4, 0.8, 1.5)
    found = searched(budgets, 60)
    for budget in budgets:
        best = found.best(budget, cases=16)
        assert best is not None and best.time == true_time(best.choices) <= budget
        assert true_loss(best.choices) <= 1.05 * best_of_all(budget)
    front = front_of_trials(list(found.trials.values()), cases=16)
    assert [t.time for t in front] == sorted(t.time or 0 for t in front)
    assert [t.loss for t in front] == sorted((t.loss for t in front), reverse=True)


def test_out_of_reach() -> None:
    found = searched((0.01,))
    assert found.best(0.01) is None
    fastest = min(t.time or math.inf for t in found.trials.values())
    slow = [true_time(SPACE.complete({"scale": 4, "cascade": "g", "shadows": "none", "guide": "none"}))]
    assert fastest <= 1.05 * slow[0], "it looked for the fastest"


@pytest.mark.slow
def test_the_same_seed_makes_the_same_trials() -> None:
    one, again, other = (
        begin((0.5,), 40, seed) for begin, seed in ((searched, 0), (search_anew, 0), (searched, 1))
    )
    assert list(one.trials) == list(again.trials) != list(other.trials)


def test_the_best_get_more_cases() -> None:
    known = Known()
    found = search(begun(), known, (0.5,))
    counts = Counter(len(t.losses) for t in found.trials.values())
    assert counts[4] > counts[8] + counts[16] and counts[16] >= 3
    assert max(known.asked.values()) == 16, "no case is judged twice"
    leading = sorted(within(found, 0.5), key=lambda t: float(np.mean(np.log(t.losses[:4]))))[:3]
    assert all(len(t.losses) >= 8 for t in leading), "the best of the first batch"
    first = next(iter(found.trials.values()))
    assert first.choices == SPACE.default and len(first.losses) == 16


def test_phases_come_in_their_order() -> None:
    told: list[Trial] = []
    found = search(begun(24, relaxes=1), Known(), (0.5,), report=lambda _, trial: told.append(trial))
    phases = list(dict.fromkeys(trial.phase for trial in told))
    assert phases == ["default", "ranges", "relaxed", "screening", "numbers", "combining"]
    count = Counter(t.phase for t in found.trials.values())
    assert count["screening"] == 12 and count["combining"] >= 3
    screened = [t.choices for t in told if t.phase == "screening"][:6]
    base = next(t.choices for t in told if t.phase == "ranges")
    names = [next(n for n in base | c if base.get(n) != c.get(n)) for c in screened]
    parts = ["scale", "cascade", "shadows", "guide", "bounces", "level_8"]
    assert sorted(names) == sorted(parts), "each is looked at first"
    relaxed = next(t for t in told if t.phase == "relaxed")
    assert relaxed.choices["level_8"] == 6 and relaxed.improve and relaxed.budget == 0.5


def test_numbers_of_each_new_best_follow_the_gradient() -> None:
    told: list[Trial] = []
    budgets = (0.5, 1.0)
    search(begun(30, relaxes=1), Known(), budgets, report=lambda _, trial: told.append(trial))
    refined = [t for t in told if t.phase == "numbers"]
    assert refined and all(t.improve == "numbers" and t.choices["kappa"] == 0.2 for t in refined)
    assert len({t.source for t in refined}) == len(refined), "each once"
    known: dict[str, Trial] = {}
    for trial in told:
        if trial.phase == "numbers":
            fitting = [t for t in known.values() if t.time is not None and t.time <= trial.budget]
            best = min(fitting, key=lambda t: t.loss)
            assert trial.source == key_of(best.choices) and best.phase != "default"
        known[key_of(trial.choices)] = trial


def test_starts_are_tried() -> None:
    start = SPACE.complete({"scale": 3, "cascade": "d"})
    found = search(begun(10, starts=[start]), Known(), (0.5,))
    assert found.trials[key_of(start)].phase == "start"


@pytest.mark.parametrize("budget", [0.5, 1.0])
def test_less_than_the_defaults_time_starts_from_the_best_start_that_fits(budget: float) -> None:
    """Of three starts, the best takes too long for the smaller budget, and the next is better than the default."""
    better, fitting, worse = (
        SPACE.complete(choices)
        for choices in ({"cascade": "h"}, {"scale": 3, "cascade": "b"}, {"scale": 3, "guide": "none"})
    )
    told: list[Trial] = []
    starts = [better, worse, fitting]
    search(begun(24, relaxes=1, starts=starts), Known(), (budget,), report=lambda _, trial: told.append(trial))
    ranges = next(t for t in told if t.phase == "ranges")
    base = SPACE.default if budget == 1 else fitting
    assert ranges.source == key_of(base)
    best = ranges.choices
    screened = [t.choices for t in told if t.phase == "screening"]
    assert screened
    for choices in screened:
        changed = {name for name in best | choices if best.get(name) != choices.get(name)}
        assert len(changed - {"size"}) == 1, "one choice at a time"


def test_the_first_budget_has_every_other_turn() -> None:
    told: list[Trial] = []
    budgets = (1.0, 0.3, 0.5, 0.7, 1.5)
    search(begun(40), Known(), budgets, report=lambda _, trial: told.append(trial))
    turns = Counter(t.budget for t in told if t.phase == "combining")
    assert turns[1.0] >= 0.45 * turns.total() and set(turns) == set(budgets)


@pytest.mark.parametrize("kept", [1, 3, 12, 20])
def test_a_kept_search_goes_on_where_it_stopped(kept: int) -> None:
    """Nothing but its trials has to be kept, and nothing that is known is asked again."""
    whole: list[Trial] = []
    end = search(begun(20, relaxes=1), Known(), (0.5,), report=lambda _, trial: whole.append(trial))
    again = functools.reduce(update, whole[:kept], begun(20, relaxes=1))
    rest: list[Trial] = []
    resumed = search(again, Known(), (0.5,), report=lambda _, trial: rest.append(trial))
    assert rest == whole[kept:] and dict(resumed.trials) == dict(end.trials)


def test_proposals_change_nothing() -> None:
    state = begun()
    first, second = propose(state, (0.5,)), propose(state, (0.5,))
    assert first == second and first is not None and not state.trials


@pytest.mark.slow
def test_times_are_predicted() -> None:
    predicted, measured = np.array(searched((0.4, 0.8, 1.5), 60).predictions).T
    assert len(predicted) >= 8 and np.median(np.abs(predicted / measured - 1)) < 0.05


def test_expired_stops() -> None:
    calls = itertools.count()
    found = search_anew((0.5,), expired=lambda: next(calls) >= 5)
    assert 3 <= len(found.trials) <= 8
    assert len(search_anew((0.5,), expired=lambda: True).trials) == 1, "the default alone"


# ---- surrogate ----


def surrogate(interaction: float = 0.0) -> Surrogate:
    trials = [SPACE.default, *SPACE.changes(SPACE.default)]
    values = [0.0, *(math.log(true_time(choices)) + interaction for choices in trials[1:])]
    return Surrogate.fit(SPACE, trials, np.array(values), np.full(len(trials), 1e-3))


def test_effects_add_up() -> None:
    """From one trial of each choice, combinations of two and three are foretold."""
    model, rng = surrogate(), np.random.default_rng(0)
    for _ in range(30):
        choices = SPACE.random(rng) | {"kappa": 0.1}
        choices = SPACE.complete(choices | {"guide": "rgb"})
        mean, spread = model.predict([choices])
        assert mean[0] == pytest.approx(math.log(true_time(choices)), abs=max(0.12, 2 * spread[0]))
    pair = SPACE.complete({"scale": 2, "shadows": "hard"})
    assert model.predict([pair])[0][0] == pytest.approx(-0.9, abs=0.1)
    here, there = model.predict([SPACE.default, SPACE.complete({"cascade": "h"})])[0]
    assert there - here == pytest.approx(0.9, abs=0.02)


def test_trials_are_reproduced_and_the_unknown_is_uncertain() -> None:
    model = surrogate()
    known, far = SPACE.complete({"scale": 4}), SPACE.complete({"scale": 4, "cascade": "g", "guide": "small"})
    mean, spread = model.predict([known, far])
    assert mean[0] == pytest.approx(-1.0, abs=0.01) and spread[0] < 0.02 < spread[1]
