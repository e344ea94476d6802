"""Search over configurations as a pure state: `init`, `propose`, `update`.

    state = init(space, batches, count)
    while (proposed := propose(state, budget)) is not None:
        state, trial = proposed
        state = update(state, judged(trial))

`judged` evaluates a trial: it makes the choices better by gradients where the trial asks for that, gives losses
relative to the default's on the same frames, and a time in turns with the default's: neither easy frames nor a busy
machine are taken for good choices. A kept search goes on by updating an initial state with its trials.

1. *Ranges*: κ, λ, α and the like of the default, or of the best start within a budget of less than its time, by the
   gradient of the whole frame.
2. *Relaxed*: levels and steps of the cascade as real numbers, by the same gradient, within each budget.
3. *Screening*: other values of the discrete choices, one at a time.
4. *Combining*: a surrogate of the loss and a model of the time propose what should be best within each budget,
   trials correct it; the numbers of each new best follow the gradient, and every few trials a best is relaxed.
5. *Halving*: the best of each budget on more frames, then on all.

Sources: Jamieson and Talwalkar, *Non-stochastic best arm identification and hyperparameter optimization*, AISTATS
2016 (successive halving); `hyjax.tuning.surrogate`.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from hyjax.tuning.space import Choices, Space, key_of, structure
from hyjax.tuning.surrogate import Surrogate
from hyjax.tuning.time_model import TimeModel
from hyjax.tuning.trial import Improvement, Trial

POOL_SIZE = 1500
"""Combinations that the surrogate is asked for at a time."""
HOPE_DEVIATIONS = 0.5
"""Standard deviations by which a loss may turn out better than predicted."""
CASE_NOISE = 0.06
"""Standard deviation of a loss relative to the default's between cases."""
REDUCTION_FACTOR = 3
"""One in so many goes on to the next batch."""
GRADIENT_TURN = 4
"""One in so many combinations is the best of a budget, made better by gradients."""


@dataclasses.dataclass(frozen=True)
class State:
    """A search as far as it has come.

    Attributes:
        batches: numbers of cases of the batches, growing.
        count: of trials on the first batch; half of them may be for screening.
        starts: choices that are tried first, such as presets'.
        relaxes: number of trials whose levels and steps are relaxed before the screening: the base's, then the
            best starts; 0 if they cannot be. If several, they come before numbers afterwards, too.
        turn: one in so many combinations is the best of a budget, made better by gradients.
        cost: time of choices over the default's where it is known; else the surrogate tells it.
        trials: so far, by key of their choices.
        tried: (improvement, key of the choices) that were asked for.
        closed: whether the time is up: the best of each budget go through all cases, nothing else is tried.
    """

    space: Space
    batches: tuple[int, ...]
    count: int
    starts: tuple[Choices, ...] = ()
    relaxes: int = 0
    turn: int = GRADIENT_TURN
    seed: int = 0
    cost: Callable[[Choices], float] | None = None
    trials: Mapping[str, Trial] = dataclasses.field(default_factory=dict)
    tried: frozenset[tuple[str, str]] = frozenset()
    closed: bool = False

    def best(self, budget: float, *, cases: int = 0) -> Trial | None:
        """The best of those within a budget that were tried on at least so many cases; None if there is none."""
        fitting = [t for t in within(self, budget) if len(t.losses) >= cases]
        return min(fitting, key=lambda t: t.loss, default=None)

    @property
    def predictions(self) -> list[tuple[float, float]]:
        """(predicted, measured) time of each trial that the surrogate proposed, relative to the default's."""
        return [(t.predicted, t.time) for t in self.trials.values() if t.predicted and t.time]


Proposed = tuple[State, Trial]


def init(
    space: Space,
    batches: Sequence[int],
    count: int,
    *,
    starts: Sequence[Choices] = (),
    relaxes: int = 0,
    turn: int = GRADIENT_TURN,
    seed: int = 0,
    cost: Callable[[Choices], float] | None = None,
) -> State:
    """State of a search that has not begun; arguments are its attributes."""
    return State(space, tuple(batches), count, tuple(starts), relaxes, turn, seed, cost)


def update(state: State, trial: Trial) -> State:
    """State with a judged trial, in place of an earlier one of the same choices."""
    key = key_of(trial.choices)
    known = state.trials.get(key)
    if known is not None:
        longer = max(trial, known, key=lambda t: len(t.losses))
        trial = dataclasses.replace(known, losses=longer.losses, time=longer.time)
    tried = state.tried | {(trial.improve, trial.source)} if trial.improve else state.tried
    return dataclasses.replace(state, trials={**state.trials, key: trial}, tried=tried)


def propose(state: State, budgets: Sequence[float]) -> Proposed | None:
    """Next trial for budgets of time, relative to the default's; None where the search is at its end.

    Args:
        state: so far.
        budgets: of time; infinite for none. The first one has every other turn.
    """
    first, trials = state.batches[0], state.trials
    space = state.space
    if key_of(space.default) not in trials:
        return state, Trial(space.default, "default", cases=first)
    if not state.closed and len(trials) < state.count:
        for choices in state.starts:
            if key_of(choices) not in trials:
                return state, Trial(choices, "start", cases=first)
        if proposed := _improved(state, _base(state, budgets[0]), "numbers", "ranges"):
            return proposed
        if (relaxed := sum(how == "relaxed" for how, _ in state.tried)) < state.relaxes:
            started = sorted((t for t in trials.values() if t.phase == "start"), key=lambda t: t.loss)
            ranked = [_start(state, budgets[0]), *started]
            for trial in ranked[relaxed:]:
                if proposed := _improved(state, trial, "relaxed", "relaxed", budgets[relaxed % len(budgets)]):
                    return proposed
        few = sum(t.phase == "screening" for t in trials.values()) < state.count // 2
        if few and (screened := _screened(state, budgets[0])) is not None:
            return state, Trial(screened, "screening", cases=first)
        if state.relaxes <= 1 and (proposed := _new_best(state, budgets)):
            return proposed
        if len(trials) % state.turn == 0 and (proposed := _better(state, budgets)):
            return proposed
        combined = sum(t.phase == "combining" for t in trials.values())
        budget = budgets[combined // 2 % len(budgets) if combined % 2 else 0]
        if (found := _combined(state, budget)) is not None:
            choices, predicted = found
            return state, Trial(choices, "combining", cases=first, budget=budget, predicted=predicted)
    return _halved(state, budgets)


def search(
    state: State,
    judged: Callable[[Trial], Trial],
    budgets: Sequence[float],
    *,
    report: Callable[[State, Trial], None] = lambda state, trial: None,
    expired: Callable[[], bool] = lambda: False,
) -> State:
    """The whole loop; `report` is called after each trial."""
    while True:
        if state.trials and expired():
            state = dataclasses.replace(state, closed=True)
        proposed = propose(state, budgets)
        if proposed is None:
            return state
        state = proposed[0]
        trial = judged(proposed[1])
        state = update(state, trial)
        report(state, trial)


def within(state: State, budget: float) -> list[Trial]:
    """Timed trials within a budget."""
    return [t for t in state.trials.values() if t.time is not None and t.time <= budget and t.losses]


def _base(state: State, budget: float) -> Trial:
    """The default, or for less than its time the best start within a budget; of many relaxed trials the default."""
    starts = [t for t in within(state, budget) if t.phase == "start" and budget < 1 and state.relaxes <= 1]
    return min(starts, key=lambda t: t.loss, default=state.trials[key_of(state.space.default)])


def _start(state: State, budget: float) -> Trial:
    """Better one of the base and the base with refined numbers."""
    base = _base(state, budget)
    refined = [t for t in state.trials.values() if t.phase == "ranges" and t.source == key_of(base.choices)]
    return min([base, *refined], key=lambda t: t.loss)


def _improved(
    state: State, trial: Trial, how: Improvement, phase: str, budget: float = math.inf
) -> Proposed | None:
    """A trial's choices, to be made better by gradients; None if they were before."""
    source = key_of(trial.choices) if how == "numbers" else f"{key_of(trial.choices)} within {budget:.4g}"
    if (how, source) in state.tried:
        return None
    more = Trial(trial.choices, phase, cases=state.batches[0], improve=how, source=source, budget=budget)
    return dataclasses.replace(state, tried=state.tried | {(how, source)}), more


def _better(state: State, budgets: Sequence[float]) -> Proposed | None:
    """The best of a budget, to be made better by gradients, unless that was done for all of them."""
    turn = len(state.trials) // state.turn
    ways: list[tuple[Improvement, str]] = [("numbers", "ranges")]
    ways += [("relaxed", "relaxed")] if state.relaxes else []
    ways = ways[::-1] if state.relaxes > 1 else ways
    for how, phase in ways:
        for number in range(len(budgets)):
            budget = budgets[(turn + number) % len(budgets)]
            best = state.best(budget)
            if best is not None and (proposed := _improved(state, best, how, phase, budget)):
                return proposed
    return None


def _new_best(state: State, budgets: Sequence[float]) -> Proposed | None:
    """The best of a budget, to have its numbers follow the gradient, if that is of other discrete choices."""
    for budget in budgets:
        best = state.best(budget)
        if best is None or best.improve or best.phase == "default":
            continue
        if proposed := _improved(state, best, "numbers", "numbers", budget):
            return proposed
    return None


def _screened(state: State, budget: float) -> Choices | None:
    """The next change of one choice, one value of each parameter after the other's; None when all were tried."""
    base = _start(state, budget).choices
    changes, rng = state.space.changes(base), np.random.default_rng(state.seed)
    turn: dict[str, int] = {}
    numbered: list[tuple[int, int, Choices]] = []
    for k in rng.permutation(len(changes)):
        choices = changes[int(k)]
        name = next(n for n in state.space.default | base if choices.get(n) != base.get(n))
        name = state.space.named[name].cascade or name  # a cascade's levels share their turns
        turn[name] = turn.get(name, 0) + 1
        numbered.append((turn[name], len(numbered), choices))
    ordered = (choices for _, _, choices in sorted(numbered, key=lambda each: each[:2]))
    return next((choices for choices in ordered if key_of(choices) not in state.trials), None)


def loss_surrogate(state: State) -> Surrogate:
    """Surrogate of the logarithm of the loss."""
    trials = [t for t in state.trials.values() if t.losses]
    choices, losses = [t.choices for t in trials], np.log([max(t.loss, 1e-9) for t in trials])
    noise = np.array([CASE_NOISE / math.sqrt(len(t.losses)) for t in trials])
    noise[0] = 1e-3  # the default is what others are relative to
    return Surrogate.fit(state.space, choices, losses, noise)


Times = Callable[[Sequence[Choices]], Float[np.ndarray, "n"]]
"""Times of choices over the default's."""


def times_of(state: State) -> Times:
    """Times where they are known, else those of a model of the timed trials."""
    cost = state.cost
    if cost is not None:
        return lambda several: np.array([cost(choices) for choices in several])
    timed = {
        structure(t.choices, state.space): (t.choices, t.time) for t in state.trials.values() if t.time is not None
    }
    choices, times = zip(*timed.values(), strict=True)
    return TimeModel.fit(state.space, choices, times)


def _combined(state: State, budget: float) -> tuple[Choices, float] | None:
    """Choices that were not tried yet and promise the least loss within a budget, with their expected time."""
    loss, time = loss_surrogate(state), times_of(state)
    pool = _pool(state, loss, time, budget)
    if not pool:
        return None
    mean, spread = loss.predict(pool)
    times = time(pool)
    fits = times <= budget
    best = int(
        np.argmin(np.where(fits, mean - HOPE_DEVIATIONS * spread, np.inf)) if fits.any() else np.argmin(times)
    )
    return pool[best], float(times[best])


def _pool(state: State, loss: Surrogate, time: Times, budget: float) -> list[Choices]:
    """Combinations of the best trials, mutated and crossed, and of the most promising single choices."""
    space, rng = state.space, np.random.default_rng([state.seed, len(state.trials)])
    tried = sorted(state.trials.values(), key=lambda t: t.loss + 10.0 * ((t.time or 1.0) > budget))[:8]
    climbed = _climbed(state, tried[0].choices, loss, time, budget)
    sources = [*(t.choices for t in tried), climbed]
    found = {key_of(choices): choices for choices in (climbed, *space.changes(tried[0].choices))}
    for _ in range(POOL_SIZE if len(space.parameters) > 8 else POOL_SIZE // 4):
        one, other = (sources[int(k)] for k in rng.integers(len(sources), size=2))
        crossed = {p.name: (other if rng.random() < 0.5 else one).get(p.name, p.default) for p in space.parameters}
        choices = space.mutated(space.complete(crossed), rng, 0.1)
        found[key_of(choices)] = choices
    return [choices for key, choices in found.items() if key not in state.trials]


def _climbed(state: State, choices: Choices, loss: Surrogate, time: Times, budget: float) -> Choices:
    """The predicted best by changes of one choice at a time."""

    def value(several: Sequence[Choices]) -> Float[np.ndarray, "n"]:
        over = np.log(time(several)) - (math.log(budget) if math.isfinite(budget) else np.inf)
        return loss.predict(several)[0] + 10.0 * np.maximum(over, 0.0)

    best = value([choices])[0]
    for _ in range(12):
        changes = state.space.changes(choices)
        values = value(changes)
        if values.min() >= best - 1e-4:
            break
        choices, best = changes[int(values.argmin())], values.min()
    return choices


def _halved(state: State, budgets: Sequence[float]) -> Proposed | None:
    """The next of the best of each budget on the larger batches, by thirds, and the default with them.

    Where the time is up, the best of each budget alone: without it there would be no result at all.
    """
    default = key_of(state.space.default)
    for size, following in itertools.pairwise(state.batches):
        chosen = {default}
        for budget in budgets:
            known = [t for t in within(state, budget) if len(t.losses) >= size]
            kept = 1 if state.closed else max(3, len(known) // REDUCTION_FACTOR)
            ranked = sorted(known, key=lambda t: float(np.mean(np.log(t.losses[:size]))))
            chosen |= {key_of(t.choices) for t in ranked[:kept]}
        for key in sorted(chosen):
            trial = state.trials[key]
            if len(trial.losses) < following:
                return state, dataclasses.replace(trial, cases=following, improve="")
    return None
