"""Proof of configurations: whole frames timed in turns, and judged on all cases, the held-out ones among them."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from hyjax.configuration import PRESETS, Configuration
from hyjax.tuning.evaluation import Scores, mean_scores
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Effect
from hyjax.tuning.trial import Trial, unbeaten
from hyjax.util.programs import forget_programs_in_time

if TYPE_CHECKING:
    from hyjax.tuning.stage import Stage

ROUNDS = 100
MOST_SECONDS = 20.0
"""Most seconds of timing, for each configuration."""
TIMING_SHARE = 0.1
"""Share of a time limit in which the best for all budgets are timed."""
OTHERS_SHARE = 0.02
"""Share of a time limit in which each other configuration is timed; an answer among them is timed once more."""
NEXT_TO_NO_LOSS, FAR_FASTER = 0.005, 0.5
"""Share of loss that is given away, and share of the time that must be left for it."""
LEAST_LOSS = 1e-9
"""Smallest loss; smaller ones count as this one, so that logarithms are finite."""


def prove(
    configurations: Sequence[Configuration],
    stage: "Stage",
    *,
    progress: bool,
    done: Callable[[], None] = lambda: None,
    most_seconds: float = math.inf,
    default: list[Scores] | None = None,
) -> list[Candidate]:
    """Configurations with times in turns, and scores on all cases.

    Args:
        stage: that they are of: its cases, and those held out, its judge and its clock.
        done: called after each configuration.
        most_seconds: of timing, all of them together.
        default: scores of the stage's base on all cases, where they are known.
    """
    most_seconds = min(most_seconds, MOST_SECONDS * len(configurations))
    times = stage.clock.times(configurations, ROUNDS, most_seconds=most_seconds)
    cases, count, judge = [*stage.cases, *stage.held_out], len(stage.cases), stage.judge
    default, found = default or judge.scores(stage.base, cases), list[Candidate]()
    bar = tqdm(configurations, "judging", unit="configuration", disable=not progress, leave=False)
    for configuration, time in zip(bar, times, strict=True):
        forget_programs_in_time()
        rows = default if configuration is stage.base else judge.scores(configuration, cases)
        own, base = (np.log([max(row["loss"], LEAST_LOSS) for row in several]) for several in (rows, default))
        logs = own - base
        tuning, held_out = (
            mean_scores(rows[part]) | {"relative": float(np.exp(np.mean(logs[part])))} if rows[part] else None
            for part in (slice(0, count), slice(count, None))
        )
        assert tuning is not None
        form = "paper" if configuration.mode == "paper" else "hyjax"
        found.append(Candidate(configuration, tuning, held_out, time, form))
        done()
    return found


def prove_in_time(
    candidates: Sequence[Configuration],
    references: Sequence[Configuration],
    stage: "Stage",
    budgets: Sequence[Budget],
    monitor: RunMonitor,
) -> tuple[list[Candidate], list[Candidate], list[str]]:
    """Candidates and references that there is time for, and the names of the others.

    Where none keeps all budgets, the fastest preset is tried in any case.

    Args:
        candidates: one for each budget, others after them.
        references: the base first.
    """
    # The answers, and what they are compared with: in any case.
    first = [*candidates[: len(budgets)], *references[:1]]
    others = [*references[1:], *candidates[len(budgets) :]]
    limit, found = monitor.limit, list[Candidate]()
    default = stage.judge.scores(stage.base, [*stage.cases, *stage.held_out])
    waiting = [[*first, *others]] if limit is None else [first, *([each] for each in others)]
    least = min(budget.milliseconds for budget in budgets)
    while waiting:
        missed = found and min(candidate.time.judged for candidate in found) > least
        fastest = [group for group in waiting if missed and group[0].name.startswith(PRESETS[-1])]
        if found and monitor.over() and not fastest:
            break
        group = [*fastest, *waiting][0]
        waiting.remove(group)
        most_seconds = math.inf if limit is None else (OTHERS_SHARE if found else TIMING_SHARE) * limit
        progress, done = monitor.progress, monitor.done
        found += prove(group, stage, progress=progress, done=done, most_seconds=most_seconds, default=default)
    proved = {id(candidate.configuration) for candidate in found}
    searched = {id(configuration) for configuration in candidates}
    tuned = [candidate for candidate in found if id(candidate.configuration) in searched]
    known = [candidate for candidate in found if id(candidate.configuration) not in searched]
    return tuned, known, [each.name for each in others if id(each) not in proved]


def front_of(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that no other beats in both median time and tuning loss, by time."""
    return unbeaten(candidates, lambda c: (c.time.median, c.tuning["relative"]))


def best_within(budget: Budget, candidates: Sequence[Candidate]) -> Candidate:
    """The best of those whose p95, as budgets are judged, is within a budget, or else the fastest.

    One that is far faster for next to no loss is preferred: the time is worth more.
    """
    fitting = [c for c in candidates if c.time.judged <= budget.milliseconds]
    if not fitting:
        return min(candidates, key=lambda c: c.time.judged)
    least = min(fitting, key=lambda c: c.tuning["relative"])
    most_loss, most_time = (1 + NEXT_TO_NO_LOSS) * least.tuning["relative"], FAR_FASTER * least.time.ratio
    cheap = [c for c in fitting if c.tuning["relative"] <= most_loss and c.time.ratio <= most_time]
    return min(cheap, key=lambda c: c.time.ratio, default=least)


def effects(trials: Sequence[Trial]) -> list[Effect]:
    """Effect on loss and time of each choice that was tried by itself."""
    starts = [t for t in trials if t.phase in ("default", "start", "ranges")] or list(trials[:1])
    screened = [t for t in trials if t.phase == "screening"]

    def changed_from(base: Trial, trial: Trial) -> list[str]:
        shared = base.choices.keys() & trial.choices.keys()
        return [name for name in shared if base.choices[name] != trial.choices[name]]

    base = max(starts, key=lambda start: sum(len(changed_from(start, t)) == 1 for t in screened))
    found = []
    for trial in screened:
        changed = changed_from(base, trial)
        if len(changed) == 1:
            (name,) = changed
            first = len(min(trial.losses, base.losses, key=len))
            ratio = float(np.exp(np.mean(np.log(trial.losses[:first])) - np.mean(np.log(base.losses[:first]))))
            time = (trial.time or 1.0) / (base.time or 1.0)
            found.append(Effect(name, trial.choices[name], base.choices[name], ratio, time))
    return found
