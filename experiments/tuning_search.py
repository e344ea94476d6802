"""Searches of `hyjax tune` trial by trial, from their journals: the loss that so many trials have led to.

    hyjax tune --rooms builtin-0 --room-size 160x120 --room-frames 3 --trials 24 --budget-ms 10000 --out tuned
    python -m experiments.tuning_search --study tuned OTHER [--limits 0.5 1 1.5] [--stage cascade]
        [--out results/tuning_search]

Journals of any version of the search are read, so that a search can be compared with an earlier one on the same
frames: losses of trials are relative to the default's there. Takes seconds.

Expect: most of the gain from the gradient of the numbers, after a handful of trials.
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, of_kind
from hyjax.tuning.frame.study import NAME, kept_trials
from hyjax.tuning.frame.trial import Trial
from hyjax.util.errors import InputError

MARKS = (4, 8, 12, 16, 24, 48)
"""Numbers of trials after which the best is told."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    study: tuple[Path, ...] = ()
    """Folders of runs of `hyjax tune`, of the same frames."""
    limits: tuple[float, ...] = (0.5, 1.0, 1.5)
    """Times over the default's that a trial may take."""
    stage: Literal["frame", "cascade"] = "frame"
    """Stage that they were of."""
    seed: int = 0


@experiment("Searches trial by trial")
def main(config: Config, start: Start) -> None:
    if not config.study:
        raise InputError("study: none given; give folders of runs of hyjax tune")
    found = {path.name: kept_trials(path / NAME, config.stage) for path in config.study}
    results = start()
    for name, trials in found.items():
        first = min(len(trial.losses) for trial in trials)
        for limit in config.limits:
            for count in sorted({min(mark, len(trials)) for mark in MARKS}):
                best = best_of(trials[:count], limit, first)
                results.add(kind="best", study=name, limit=limit, trials=count, cases=first, loss=best)
            whole = max(len(trial.losses) for trial in trials)
            judged = [trial for trial in trials if len(trial.losses) == whole]
            loss = best_of(judged, limit, whole)
            results.add(kind="end", study=name, limit=limit, trials=len(trials), cases=whole, loss=loss)


def best_of(trials: Sequence[Trial], limit: float, cases: int) -> float | None:
    """Least loss over the default's of the trials within a time, on the first cases."""
    fitting = [
        t.losses[:cases] for t in trials if t.time is not None and t.time <= limit and len(t.losses) >= cases
    ]
    return min((math.exp(sum(map(math.log, losses)) / cases) for losses in fitting), default=None)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table from the rows."""
    best, end = of_kind(rows, "best"), of_kind(rows, "end")
    counts = sorted({row["trials"] for row in best})
    lines = []
    for last in end:
        own = {r["trials"]: r["loss"] for r in best if (r["study"], r["limit"]) == (last["study"], last["limit"])}
        cells = [percent(own.get(count)) for count in counts]
        lines.append([last["study"], f"{last['limit']:g}", *cells, percent(last["loss"])])
    header = ["search", "time", *(f"{count} trials" for count in counts), "all frames"]
    caption = (
        "Least loss against the default's within a time over the default's, after so many trials, on the frames of "
        "the first batch; last on all tuning frames."
    )
    return [Table(caption, header, lines, names=1)]


def percent(loss: float | None) -> str:
    """A loss over the default's as a change."""
    return "–" if loss is None else f"{100 * (loss - 1):+.1f} %"


if __name__ == "__main__":
    run(main)
