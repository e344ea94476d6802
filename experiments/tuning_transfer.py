"""Cost of using a schedule in another room than it was tuned in.

    python -m experiments.tuning_transfer --kitchen PATH [--budget-ms 4] [--out results/tuning_transfer]

Tunes once on the built-in room and once on the capture, at the same budget, and judges both schedules, and
`paper-80` with our default κ and λ, on held-out frames (of the last quarter) of both. All times are taken afresh at
the end, in turns. Takes about ten minutes on two cores.

Expect: the schedule tuned elsewhere within a few percent of the scene's own loss, on either side, and ahead of
`paper-80`.
"""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from experiments.tuning_scenes import (
    ComparisonConfig,
    add_scores,
    comparison,
    conditions,
    mean,
    mean_scores,
    open_scenes,
    retime,
    scenes_of,
    score_headings,
    scored,
    texts,
)
from hyjax.core.schedule import Schedule
from hyjax.tuning.cases import raw_filter, refined_filter
from hyjax.tuning.request import parse_budgets
from hyjax.tuning.run import tune_bench
from hyjax.tuning.settings import TuneScene, TuneSettings
from hyjax.util.errors import InputError

RAW = "raw filter"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(ComparisonConfig):
    kitchen: Path
    """The capture to tune on besides the built-in room."""
    budget_ms: float = 4.0


@experiment("A schedule in another room than it was tuned in")
def main(config: Config, start: Start) -> None:
    budgets = parse_budgets((), (config.budget_ms,))
    scenes = open_scenes(config.kitchen, config.size, config.frames, config.holdout)
    results = start()
    schedules, settings = {}, TuneSettings(TuneScene(seed=config.seed), extra=False)
    for scene in scenes:
        found = tune_bench(
            scene.bench, settings, budgets=budgets, frames=scene.frames, effort=config.effort
        ).schedule
        if not found.name.startswith("tuned"):
            raise InputError(f"{scene.name}: nothing tuned came out within {config.budget_ms:g} ms; give more")
        results.add(**scene.record())
        schedules[tuned_on(scene.name)] = found
    schedules["paper-80"] = Schedule.preset("paper-80")
    for name, schedule in schedules.items():
        results.add(kind="schedule", name=name, **texts(schedule))
    for scene in scenes:
        held = scene.held_out()
        add_scores(results, scene.name, RAW, held, lambda case: raw_filter(case.shaded))
        for name, schedule in schedules.items():
            add_scores(results, scene.name, name, held, functools.partial(refined_filter, schedule=schedule))
    (times,) = retime([(next(iter(held.values())), list(schedules.values()))], config.repeats)
    for name, time in zip(schedules, times, strict=True):
        results.add(kind="time", name=name, **dataclasses.asdict(time))


def tuned_on(scene: str) -> str:
    return f"tuned on {scene}"


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    if not of_kind(rows, "score"):
        return ["No schedule has been judged yet."]
    times = {row["name"]: row for row in of_kind(rows, "time")}
    schedules = []
    for row in of_kind(rows, "schedule"):
        time = times.get(row["name"])
        cells = [f"{time['median']:.2f}", f"{time['p95']:.2f}"] if time else ["–", "–"]
        values = [row.get(key, "–") for key in ("steps", "kappa", "lam", "fidelity")]
        schedules.append([row["name"], *values, *cells])
    lines = []
    for scene in scenes_of(rows):
        for name, each in scored(rows, scene).items():
            text = f"{name} (its own)" if name == tuned_on(scene) else name
            lines.append([scene, text, *mean_scores(each)])

    def pairs(scene: str, names: list[str]) -> list[tuple[str, str]]:
        own = tuned_on(scene)
        return [(name, own) for name in names if name not in (own, RAW)]

    header = ["schedule", "steps", "κ", "λ", "α", "median ms", "p95 ms"]
    return [
        Table(f"The schedules; {conditions(rows)}", header, schedules, names=5),
        Table(
            "Means over held-out frames.",
            ["held-out frames of", "schedule", *score_headings()],
            lines,
            names=2,
        ),
        comparison(rows, pairs, lambda _, name: times.get(name)),
        Plot(main.name, "Loss on held-out frames: the mean, and each frame as a small dot.", figure(rows)),
    ]


def figure(rows: Sequence[Row]) -> Figure:
    """Held-out loss by scene and schedule, each frame a small dot."""
    scenes, times = scenes_of(rows), {row["name"]: row for row in of_kind(rows, "time")}
    fig = new_figure(2.0 + 3.5 * len(scenes), 2.6)
    for axes, scene in zip(fig.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        judged = scored(rows, scene)
        for y, (name, each) in enumerate(judged.items()):
            color = "C0" if name == tuned_on(scene) else "C1" if name.startswith("tuned") else "0.5"
            axes.plot([row["loss"] for row in each], [y] * len(each), ".", color=color, alpha=0.35)
            axes.plot(mean(each, "loss"), y, "o", color=color)
        names = [f"{name}\n{times[name]['median']:.2f} ms" if name in times else name for name in judged]
        axes.set_yticks(range(len(names)), names, fontsize=8)
        axes.margins(y=0.15)
        axes.invert_yaxis()
        axes.grid(axis="x", color="0.9")
        axes.set(xlabel="loss on held-out frames", title=scene)
    return fig


if __name__ == "__main__":
    run(main)
