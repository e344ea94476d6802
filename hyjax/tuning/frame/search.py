"""Search over configurations: each choice by itself, then the combinations that these promise, on growing batches.

Losses are relative to the default's on the same frames, times are in turns with the default's: neither easy frames
nor a busy machine are taken for good choices. A trial is one evaluation on a mini-batch, and every trial is timed.

1. *Ranges* of the default, κ, λ, α and the like, by the gradient of the whole frame (`refinement`).
2. *Screening*: other values of the discrete choices, one at a time.
3. *Combining*: a surrogate of loss and time proposes what should be best within each budget; trials correct it.
4. *Halving*: the best of each budget on more frames, then on all.

Sources: Jamieson and Talwalkar, *Non-stochastic best arm identification and hyperparameter optimization*, AISTATS
2016 (successive halving); `hyjax.tuning.frame.surrogate`.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from hyjax.tuning.frame.space import Choices, Space, key_of, structure
from hyjax.tuning.frame.surrogate import Surrogate

POOL = 3000
"""Combinations that the surrogate is asked for at a time."""
HOPE = 0.5
"""Standard deviations by which a loss may turn out better than predicted."""
CASE_NOISE = 0.06
"""Standard deviation of a loss relative to the default's between cases."""
TIME_NOISE = 0.05
"""Likewise of a time, relative to the default's."""
RETAINED = 3
"""One in so many goes on to the next batch."""


@dataclasses.dataclass
class Trial:
    """Choices that were tried.

    Attributes:
        choices: of the space.
        phase: which part of the search asked for it.
        losses: on the cases so far, in their order, relative to the default's.
        time: of a frame, relative to the default's; None if it was not timed.
    """

    choices: Choices
    phase: str
    losses: list[float] = dataclasses.field(default_factory=list)
    time: float | None = None

    @property
    def loss(self) -> float:
        """Geometric mean of the losses."""
        return float(np.exp(np.mean(np.log(self.losses)))) if self.losses else math.inf


class Evaluator(Protocol):
    """What the search asks."""

    def losses(self, choices: Choices, first: int, last: int) -> list[float]:
        """Losses relative to the default's on cases of these numbers."""
        ...

    def time(self, choices: Choices) -> float:
        """Time of a frame relative to the default's."""
        ...

    def refine(self, choices: Choices, batch: int) -> Choices:
        """The choices with better numbers of their ranges, by gradients on the first cases."""
        ...


class FrameSearch:
    """Search on one space.

    Attributes:
        trials: so far, by key of their choices.

    Args:
        space: of the choices.
        evaluator: what is asked.
        batches: numbers of cases of the batches, growing.
        seed: of the proposals.
        report: called with each trial.
        expired: whether the time is up.
    """

    def __init__(
        self,
        space: Space,
        evaluator: Evaluator,
        batches: Sequence[int],
        *,
        seed: int = 0,
        report: Callable[[Trial], None] = lambda trial: None,
        expired: Callable[[], bool] = lambda: False,
    ) -> None:
        self.space, self.evaluator, self.batches = space, evaluator, tuple(batches)
        self._rng, self._report, self._expired = np.random.default_rng(seed), report, expired
        self.trials: dict[str, Trial] = {}
        # What differs from the default in numbers alone takes as long; of the paper's form none does.
        self._times: dict[str, float] = {} if space.paper else {structure(space.default, space): 1.0}
        self.predictions: list[tuple[float, float]] = []
        """(predicted, measured) time of each trial that the surrogate proposed, relative to the default's."""

    def run(self, budgets: Sequence[float], count: int, starts: Sequence[Choices] = ()) -> None:
        """So many trials for budgets of time, relative to the default's; infinite for none.

        Args:
            budgets: each.
            count: of trials, on the first batch; half of them may be for screening.
            starts: choices that are tried first, such as presets'.
        """
        base = self.try_out(self.space.default, "default")
        for choices in starts:
            self.try_out(choices, "start")
        best = base
        if not self._expired():
            best = self.try_out(self.evaluator.refine(base.choices, self.batches[0]), "ranges")
        for choices in self._screened(min(base, best, key=lambda t: t.loss).choices, count // 2):
            if self._expired():
                break
            self.try_out(choices, "screening")
        while len(self.trials) < count and not self._expired():
            budget = budgets[len(self.trials) % len(budgets)]
            proposal = self.propose(budget)
            if proposal is None:
                break
            self.try_out(proposal, "combining")
        self.halve(budgets)

    def try_out(self, choices: Choices, phase: str) -> Trial:
        """Trial of choices on the first batch, unless there is one."""
        key = key_of(choices)
        if key not in self.trials:
            trial = Trial(choices, phase, self.evaluator.losses(choices, 0, self.batches[0]))
            same = structure(choices, self.space)
            if same not in self._times:
                self._times[same] = self.evaluator.time(choices)
                if phase == "combining":
                    self.predictions.append((self._predicted_time(choices), self._times[same]))
            trial.time = self._times[same]
            self.trials[key] = trial
            self._report(trial)
        return self.trials[key]

    def best(self, budget: float, *, cases: int = 0) -> Trial | None:
        """The best of those within a budget that were tried on at least so many cases; None if there is none."""
        fitting = [
            t for t in self.trials.values() if len(t.losses) >= cases and t.time is not None and t.time <= budget
        ]
        return min(fitting, key=lambda t: t.loss, default=None)

    def front(self) -> list[Trial]:
        """Trials on all cases that no other beats in both time and loss, by time."""
        return front_of_trials(list(self.trials.values()), cases=self.batches[-1])

    def _screened(self, base: Choices, most: int) -> list[Choices]:
        """Changes of one choice, one value of each parameter after the other's."""
        changes = self.space.changes(base)
        changes = [changes[int(k)] for k in self._rng.permutation(len(changes))]
        turn: dict[str, int] = {}
        numbered: list[tuple[int, int, Choices]] = []
        for choices in changes:
            name = next(n for n in self.space.default | base if choices.get(n) != base.get(n))
            turn[name] = turn.get(name, 0) + 1
            numbered.append((turn[name], len(numbered), choices))
        return [choices for _, _, choices in sorted(numbered, key=lambda each: each[:2])][:most]

    def surrogates(self) -> tuple[Surrogate, Surrogate]:
        """Of the logarithms of loss and time."""
        trials = list(self.trials.values())
        choices, losses = [t.choices for t in trials], np.log([t.loss for t in trials])
        noise = np.array([CASE_NOISE / math.sqrt(len(t.losses)) for t in trials])
        noise[0] = 1e-3  # the default is what others are relative to
        loss = Surrogate.fit(self.space, choices, losses, noise)
        times = np.log([t.time or 1.0 for t in trials])
        return loss, Surrogate.fit(self.space, choices, times, np.full(len(trials), TIME_NOISE))

    def _predicted_time(self, choices: Choices) -> float:
        return float(np.exp(self.surrogates()[1].predict([choices])[0][0])) if self.trials else 1.0

    def propose(self, budget: float) -> Choices | None:
        """Choices that were not tried yet and promise the least loss within a budget."""
        loss, time = self.surrogates()
        pool = self._pool(loss, time, budget)
        if not pool:
            return None
        mean, spread = loss.predict(pool)
        fits = time.predict(pool)[0] <= math.log(budget) if math.isfinite(budget) else np.ones(len(pool), bool)
        if not fits.any():  # then the fastest
            return pool[int(np.argmin(time.predict(pool)[0]))]
        return pool[int(np.argmin(np.where(fits, mean - HOPE * spread, np.inf)))]

    def _pool(self, loss: Surrogate, time: Surrogate, budget: float) -> list[Choices]:
        """Combinations of the best trials, changed and crossed, and of what promises most by itself."""
        tried = sorted(self.trials.values(), key=lambda t: t.loss + 10.0 * ((t.time or 1.0) > budget))[:8]
        found: dict[str, Choices] = {}
        climbed = self._climb(tried[0].choices, loss, time, budget)
        sources = [*(t.choices for t in tried), climbed]
        for _ in range(POOL):
            one, other = (sources[int(k)] for k in self._rng.integers(len(sources), size=2))
            crossed = {
                p.name: (other if self._rng.random() < 0.5 else one).get(p.name, p.default)
                for p in self.space.parameters
            }
            choices = self.space.mutated(self.space.complete(crossed), self._rng, 0.1)
            found[key_of(choices)] = choices
        found[key_of(climbed)] = climbed
        return [choices for key, choices in found.items() if key not in self.trials]

    def _climb(self, choices: Choices, loss: Surrogate, time: Surrogate, budget: float) -> Choices:
        """The predicted best by changes of one choice at a time."""

        def value(several: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "n"]:
            over = time.predict(several)[0] - (math.log(budget) if math.isfinite(budget) else np.inf)
            return loss.predict(several)[0] + 10.0 * np.maximum(over, 0.0)

        best = value([choices])[0]
        for _ in range(12):
            changes = self.space.changes(choices)
            values = value(changes)
            if values.min() >= best - 1e-4:
                break
            choices, best = changes[int(values.argmin())], values.min()
        return choices

    def halve(self, budgets: Sequence[float]) -> None:
        """The best of each budget on the larger batches, by thirds, and the default with them.

        Where the time is up, the best of each budget alone: without it there would be no result at all.
        """
        (default, *_), chosen = self.trials.values(), set[str]()
        for size, following in zip(self.batches, self.batches[1:], strict=False):
            chosen = {key_of(default.choices)}
            for budget in budgets:
                known = [
                    t
                    for t in self.trials.values()
                    if t.time is not None and t.time <= budget and len(t.losses) >= size
                ]
                kept = 1 if self._expired() else max(3, len(known) // RETAINED)
                chosen |= {key_of(t.choices) for t in sorted(known, key=lambda t: t.loss)[:kept]}
            for key in sorted(chosen):
                trial = self.trials[key]
                if len(trial.losses) < following:
                    trial.losses += self.evaluator.losses(trial.choices, len(trial.losses), following)
                    self._report(trial)


def front_of_trials(trials: Sequence[Trial], *, cases: int = 1) -> list[Trial]:
    """Timed trials on at least so many cases that no other of them beats in both time and loss, by time."""
    found: list[Trial] = []
    done = [(trial.time, trial.loss, trial) for trial in trials if trial.time is not None]
    for _, loss, trial in sorted(
        (each for each in done if len(each[2].losses) >= cases), key=lambda each: each[:2]
    ):
        if not found or loss < found[-1].loss:
            found.append(trial)
    return found
