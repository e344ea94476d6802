"""Unfinished search as a result: candidates with what their trials tell, before they are proven."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hyjax.configuration import DEFAULT, Configuration
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.evaluation import Scores
from hyjax.tuning.proof import effects
from hyjax.tuning.report_text import UNFINISHED
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Tuned
from hyjax.tuning.search import State, within
from hyjax.tuning.space import key_of
from hyjax.tuning.trial import Trial, front_of_trials


def best_known(state: State, limit: float) -> Trial | None:
    """The best trial within a limit of those on the most cases: few cases flatter. None if none is within it."""
    return state.best(limit, cases=max((len(trial.losses) for trial in within(state, limit)), default=0))


def best_or_fastest(state: State, limit: float) -> Trial | None:
    """The best trial within a limit, see `best_known`, or else the fastest; None if none was timed."""
    return best_known(state, limit) or min(within(state, math.inf), key=lambda t: t.time or 0.0, default=None)


def unfinished(
    state: State, *, base: FrameTime, budgets: Sequence[Budget], limits: Sequence[float], record: Mapping[str, Any]
) -> Tuned:
    """Result of the trials so far.

    Args:
        state: with a timed trial at least.
        base: time of the default.
        limits: of each of them, over the default's time.
    """

    scores: dict[str, Scores] = {}

    def candidate(trial: Trial, name: str) -> Candidate:
        share = trial.time or 1.0
        time = FrameTime(share * base.median, share * base.judged, base.median, share)
        tuning = scores.setdefault(key_of(trial.choices), {"relative": trial.loss})
        return Candidate(state.space.configuration(trial.choices, name), tuning, None, time)

    trials = list(state.trials.values())
    chosen = [best_or_fastest(state, limit) for limit in limits]
    best = [candidate(t, f"tuned-{b.slug}") for t, b in zip(chosen, budgets, strict=True) if t is not None]
    front = [candidate(trial, f"trial-{trial.time:.3f}") for trial in front_of_trials(trials)]
    default = state.trials.get(key_of(state.space.default))
    references = [] if default is None else [candidate(default, DEFAULT)]
    if default is not None and default.time != 1.0:  # it has another's light, see `FrameStage.base_time`
        own = FrameTime(base.median, base.judged, base.median, 1.0)
        references = [Candidate(Configuration(), {"relative": 1.0}, None, own)]
    told = dict(record) | {"trials": len(trials), UNFINISHED: True}
    return Tuned(best[0].configuration, best, list(budgets), front, references, trials, effects(trials), [], told)
