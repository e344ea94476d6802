"""Replay of a kept study: the front of a search on another machine or other scenes, timed and judged anew."""

from collections.abc import Sequence
from pathlib import Path

from hyjax.configuration import Configuration
from hyjax.data.frames import spread
from hyjax.tuning.bench import open_frame_bench
from hyjax.tuning.proof import best_within, effects, front_of, prove
from hyjax.tuning.result import Tuned
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.space import Space
from hyjax.tuning.stage import FrameStage, examples
from hyjax.tuning.study import kept_trials
from hyjax.tuning.trial import Trial, front_of_trials

POINT_COUNT = 3


def replay(journal: Path, settings: TuneSettings) -> Tuned:
    """Result of a kept study without searching again.

    A few points of the front, the default and the paper's form are timed here and judged on the frames of the
    settings. Trials and effects are those of the study, relative to the default on its own machine and frames.

    Args:
        journal: `study.log` of a run of `hyjax tune`.
        settings: budgets, and the frames to judge on.

    Raises:
        InputError: the journal has no trials, or the settings cannot be used.
    """
    trials = kept_trials(journal)
    bench = open_frame_bench(settings.check())
    found = [Configuration(), Configuration.paper(), *front_configurations(trials)]
    candidates = prove(found, FrameStage(bench, settings), progress=not settings.quiet)
    references, tuned, budgets = candidates[:2], candidates[2:], settings.budgets()
    best = [best_within(budget, tuned) for budget in budgets]
    front = front_of(tuned)
    return Tuned(
        best[0].configuration,
        best,
        budgets,
        front,
        references,
        trials,
        effects(trials),
        examples(bench, front),
        {"settings": settings.record(), "cases": len(bench.cases), "held-out cases": len(bench.held_out)},
    )


def front_configurations(trials: Sequence[Trial]) -> list[Configuration]:
    """Configurations of a few points of the front of those trials that were judged on the most cases."""
    most = max((len(trial.losses) for trial in trials), default=0)
    front, space = front_of_trials(trials, cases=most), Space.of(truth=True)
    return [space.configuration(t.choices, f"tuned-{t.time:.2f}") for t in spread(front, POINT_COUNT)]
