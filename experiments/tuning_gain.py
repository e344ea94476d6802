"""Gain of tuning over the paper's schedules at the same measured time, and at half of it, on held-out frames.

    python -m experiments.tuning_gain [--kitchen PATH] [--out results/tuning_gain]

Tunes for the measured p95 of `paper-50`, of `paper-80`, and for half of the latter, and judges on frames of the
last quarter of the capture, on which nothing is chosen. Beside them: the bare raw filter, the best constant (which
knows each frame's target), the naive schedules, our preset, and the paper's steps in the form that is searched,
with κ, λ and α polished on the tuning frames: these tell what the form and its values gain from what the steps'
places gain. All times are taken afresh at the end, in turns. Takes about ten minutes on two cores.

Expect: tuned schedules five to ten percent below the paper's loss in a third of `paper-80`'s time; level with the
polished ones, so that κ and λ make the quality and the places of the steps the speed. `naive-50` is as good where
its time is allowed. Intervals are wide, being over six frames.
"""

import dataclasses
import functools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from experiments.blocks import Block, Plot, Table
from experiments.command import Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from experiments.tuning_scenes import (
    ComparisonConfig,
    Scene,
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
from hyjax.tuning.cascade import BASELINES, tune_bench
from hyjax.tuning.cases import Case, raw_filter, refined_filter
from hyjax.tuning.descent import Objective, polish
from hyjax.tuning.latency_estimator import CascadeEstimator
from hyjax.tuning.relaxation import RelaxedSchedule, prepare
from hyjax.tuning.result import Budget
from hyjax.tuning.settings import FrameOptions, TuneScene, TuneSettings
from hyjax.util.errors import InputError

COMPARISONS = (
    ("hyjax", "paper-50"),
    ("tuned, time of paper-50", "hyjax"),
    ("paper-50 polished", "paper-50"),
    ("tuned, time of paper-50", "paper-50"),
    ("tuned, time of paper-50", "paper-50 polished"),
    ("paper-80 polished", "paper-80"),
    ("tuned, time of paper-80", "paper-80"),
    ("tuned, time of paper-80", "paper-80 polished"),
    ("tuned, time of paper-80", "naive-50"),
    ("tuned, half of paper-80", "paper-80"),
    ("tuned, half of paper-80", "paper-80 polished"),
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(ComparisonConfig):
    kitchen: Path | None = None
    """A capture to tune on besides the built-in room."""
    polishing: int = 40
    """Iterations of κ, λ and α of the paper's steps."""


@experiment("What tuning gains")
def main(config: Config, start: Start) -> None:
    scenes = open_scenes(config.kitchen, config.size, config.frames, config.holdout)
    results = start()
    runs, judged = [], []
    for scene in scenes:
        tuning, _ = scene.bench.cases(scene.frames, "tuning")
        held = scene.held_out()
        schedules, budgets = candidates(scene, tuning, config)
        results.add(**scene.record())
        runs.append((tuning[0], list(schedules.values())))
        judged += [(scene.name, name) for name in schedules]
        add_scores(results, scene.name, "raw filter", held, lambda case: raw_filter(case.shaded))
        add_scores(results, scene.name, "best constant", held, best_constant)
        for name, schedule in schedules.items():
            known = {"scene": scene.name, "name": name, "budget_ms": budgets.get(name)}
            results.add(kind="schedule", **known, **texts(schedule))
            add_scores(results, scene.name, name, held, functools.partial(refined_filter, schedule=schedule))
    times = [time for own in retime(runs, config.repeats) for time in own]
    for (scene_name, name), time in zip(judged, times, strict=True):
        results.add(kind="time", scene=scene_name, name=name, **dataclasses.asdict(time))


def best_constant(case: Case) -> Any:
    """The mean of the target's filter where it means anything: one colour for the whole frame."""
    weight = case.valid[..., None]
    mean = jnp.sum(case.target * weight, axis=(0, 1)) / jnp.sum(weight)
    return jnp.broadcast_to(mean, case.target.shape)


def candidates(scene: Scene, tuning: list[Case], config: Config) -> tuple[dict[str, Schedule], dict[str, float]]:
    """All schedules by name, and the budgets of the tuned ones in milliseconds; those out of reach are left out."""
    table = CascadeEstimator(tuning[0]).table
    ladder = table.factors
    schedules = {name: Schedule.preset(name) for name in BASELINES}
    papers = [name for name in BASELINES if name.startswith("paper")]
    objective = Objective([prepare(case, ladder) for case in tuning], ladder)
    for name in papers:
        plan = RelaxedSchedule.of(table.steps_of(schedules[name]))
        polished = polish(objective, plan, config.polishing).point.schedule(ladder)
        schedules[f"{name} polished"] = dataclasses.replace(polished, name=f"{name} polished")
    # Timed now: what the latency table remembers of them may be from another hour.
    (times,) = retime([(tuning[0], [schedules[name] for name in papers])], config.repeats)
    budgets = {f"tuned, time of {name}": time.p95 for name, time in zip(papers, times, strict=True)}
    budgets["tuned, half of paper-80"] = 0.5 * budgets["tuned, time of paper-80"]
    found = tuned(scene, config, budgets)
    return schedules | found, {name: time for name, time in budgets.items() if name in found}


def tuned(scene: Scene, config: Config, budgets: dict[str, float]) -> dict[str, Schedule]:
    """Tuned schedules by the names of their budgets, without those that the device cannot keep."""
    options = FrameOptions(trials=config.trials)
    settings = TuneSettings(TuneScene(seed=config.seed), frame=options, extra=False)
    ascending = sorted(budgets, key=lambda name: budgets[name])
    while ascending:
        names = [name for name in budgets if name in ascending]
        try:
            limits = [Budget(f"{budgets[name]:.3g} ms", budgets[name]) for name in names]
            found = tune_bench(scene.bench, settings, budgets=limits, frames=scene.frames)
        except InputError as error:
            print(f"{scene.name}: {ascending.pop(0)}: {error}", file=sys.stderr)
            continue
        return {name: best.configuration.schedule for name, best in zip(names, found.best, strict=True)}
    return {}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    if not of_kind(rows, "score"):
        return ["No schedule has been judged yet."]
    schedules, times = by_name(rows, "schedule"), by_name(rows, "time")
    lines = []
    for scene in scenes_of(rows):
        for name, each in scored(rows, scene).items():
            schedule, time = schedules.get((scene, name)), times.get((scene, name))
            cells = [f"{time['median']:.2f}", f"{time['p95']:.2f}"] if time else ["–", "–"]
            cells += mean_scores(each)
            lines.append([scene, label(name, schedule), schedule["steps"] if schedule else "–", *cells])
    header = ["scene", "held-out frames", "steps", "median ms", "p95 ms", *score_headings()]
    return [
        Table(f"Means over held-out frames; {conditions(rows)}", header, lines, names=3),
        comparison(rows, lambda *_: COMPARISONS, lambda *key: times.get(key)),
        Plot(main.name, "Loss on held-out frames: the mean, and each frame as a small dot.", figure(rows)),
    ]


def by_name(rows: Sequence[Row], kind: str) -> dict[tuple[str, str], Row]:
    """Rows of a kind by scene and name."""
    return {(row["scene"], row["name"]): row for row in of_kind(rows, kind)}


def label(name: str, schedule: Row | None) -> str:
    """The name; with the schedule's own where nothing tuned came out in time and another stands in."""
    stands_in = schedule is not None and name.startswith("tuned") and not schedule["schedule"].startswith("tuned")
    return f"{name} ({schedule['schedule']})" if schedule and stands_in else name


def figure(rows: Sequence[Row]) -> Figure:
    """Held-out loss of every schedule, each frame a small dot, with its median time."""
    scenes, schedules, times = scenes_of(rows), by_name(rows, "schedule"), by_name(rows, "time")
    fig = new_figure(2.0 + 4.2 * len(scenes), 4.5)
    for axes, scene in zip(fig.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        judged, names = scored(rows, scene), []
        for y, (name, each) in enumerate(judged.items()):
            color = next((c for kind, c in KINDS.items() if name.startswith(kind)), "0.5")
            axes.plot([row["loss"] for row in each], [y] * len(each), ".", color=color, alpha=0.35)
            axes.plot(mean(each, "loss"), y, "o", color=color)
            time = times.get((scene, name))
            text = label(name, schedules.get((scene, name)))
            names.append(f"{text}\n{time['median']:.2f} ms" if time else text)
        axes.set_yticks(range(len(judged)), names, fontsize=8)
        axes.invert_yaxis()
        axes.grid(axis="x", color="0.9")
        axes.set(xscale="log", xlabel="loss on held-out frames", title=scene)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    return fig


KINDS = {"tuned": "C0", "hyjax": "C3", "paper": "C1", "naive": "C2"}


if __name__ == "__main__":
    run(main)
