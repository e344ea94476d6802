"""What tuning gains over the paper's schedules at the same measured time, and at half of it, on held-out frames.

    python -m experiments.tuning_gain [--kitchen PATH] [--out results/tuning_gain]

Tunes for the measured p95 of `paper-50`, of `paper-80`, and for half of the latter, and judges on frames of the
last quarter of the capture, on which nothing is chosen. Beside them: the bare raw filter, the best constant (which
knows each frame's target), the naive schedules, and the paper's schedules with κ and λ polished on the tuning
frames: these tell what κ and λ gain from what the steps' places gain. All times are taken afresh at the end, in
turns. Takes about ten minutes on two cores. Writes `tuning_gain.json`, `.md` and `.png`.

Expect: tuned schedules five to ten percent below the paper's loss in a third of `paper-80`'s time; level with the
polished ones, so that κ and λ make the quality and the places of the steps the speed. `naive-50` is as good where
its time is allowed. Intervals are wide, being over six frames.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from experiments.command import run
from experiments.plotting import new_figure
from experiments.tuning_scenes import (
    ComparisonConfig,
    Scene,
    compare,
    comparison_table,
    footer,
    mean_scores,
    open_scenes,
    retime,
    score_each,
    write_results,
)
from hyjax.errors import InputError
from hyjax.files import make_writable
from hyjax.schedule import Schedule
from hyjax.tuning.cases import Case, mix, refined_filter
from hyjax.tuning.clocked import CascadeClock, check_reachable
from hyjax.tuning.descent import Objective, polish
from hyjax.tuning.relaxation import Plan, prepare
from hyjax.tuning.report_text import kappa_text, lam_text, steps_text
from hyjax.tuning.result import Budget, Scores
from hyjax.tuning.run import BASELINES, tune_bench

COMPARISONS = (
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
    """Iterations of κ and λ of the paper's schedules."""
    out: Path = Path("results/tuning_gain")


def main(config: Config) -> None:
    make_writable(config.out)
    scenes = open_scenes(config.kitchen, config.size, config.frames, config.holdout)
    rows: list[dict[str, Any]] = []
    comparisons: list[dict[str, Any]] = []
    runs = []
    for scene in scenes:
        tuning, _ = scene.bench.cases(scene.frames, "tuning")
        held, _ = scene.bench.cases(scene.holdout, "held-out")
        schedules, budgets = candidates(scene, tuning, config)
        runs.append((tuning[0], list(schedules.values())))
        plain = {
            "raw filter": (None, [mix(case.shading, case.colors) for case in held]),
            "best constant": (None, [best_constant(case) for case in held]),
        }
        judged: dict[str, list[Scores]] = {}
        for name, (schedule, filters) in plain.items():
            judged[name] = score_each(held, filters)
            rows.append(row(scene, name, schedule, judged[name]))
        for name, schedule in schedules.items():
            judged[name] = score_each(held, [refined_filter(case, schedule) for case in held])
            rows.append(row(scene, name, schedule, judged[name]) | {"budget_ms": budgets.get(name)})
        comparisons += [
            {"scene": scene.name} | compare(own, judged[own], other, judged[other])
            for own, other in COMPARISONS
            if own in judged and other in judged
        ]
    times = iter([time for own in retime(runs, config.repeats) for time in own])
    for entry in rows:
        entry["again"] = dataclasses.asdict(next(times)) if entry["schedule"] else None
    again = {(entry["scene"], entry["name"]): entry["again"] for entry in rows}
    for entry in comparisons:
        own, other = (again[entry["scene"], entry[key]]["median"] for key in ("schedule", "against"))
        entry["time_ratio"] = own / other
    record = {
        "rows": rows,
        "comparisons": comparisons,
        "scenes": [scene.record() for scene in scenes],
        "config": str(config),
    }
    table = [*markdown(rows), "", *comparison_table(comparisons), *footer(scenes, config.size)]
    write_results(config.out, "tuning_gain", record, table, figure(rows))


def best_constant(case: Case) -> Any:
    """The mean of the target's filter where it means anything: one colour for the whole frame."""
    weight = case.valid[..., None]
    mean = jnp.sum(case.target * weight, axis=(0, 1)) / jnp.sum(weight)
    return jnp.broadcast_to(mean, case.target.shape)


def candidates(scene: Scene, tuning: list[Case], config: Config) -> tuple[dict[str, Schedule], dict[str, float]]:
    """All schedules by name, and the budgets of the tuned ones in milliseconds; those out of reach are left out."""
    clock = CascadeClock(tuning[0])
    ladder = clock.table.ladder
    schedules = {name: Schedule.preset(name) for name in BASELINES}
    papers = [name for name in BASELINES if name.startswith("paper")]
    objective = Objective([prepare(case, ladder) for case in tuning], ladder)
    for name in papers:
        plan = Plan.of(clock.table.steps_of(schedules[name]))
        polished = polish(objective, plan, config.polishing).plan.schedule(ladder)
        schedules[f"{name} polished"] = dataclasses.replace(polished, name=f"{name} polished")
    # Timed now: what the latency table remembers of them may be from another hour.
    (times,) = retime([(tuning[0], [schedules[name] for name in papers])], config.repeats)
    budgets = {f"tuned, time of {name}": time.p95 for name, time in zip(papers, times, strict=True)}
    budgets["tuned, half of paper-80"] = 0.5 * budgets["tuned, time of paper-80"]
    for name, time in list(budgets.items()):
        try:
            check_reachable(clock, time)
        except InputError as error:
            print(f"{scene.name}: {name}: {error}", file=sys.stderr)
            del budgets[name]
    if budgets:
        found = tune_bench(
            scene.bench,
            [Budget(f"{time:.3g} ms", time) for time in budgets.values()],
            frames=scene.frames,
            seed=config.seed,
            effort=config.effort,
            extra=False,
        )
        schedules |= {name: best.schedule for name, best in zip(budgets, found.best, strict=True)}
    return schedules, budgets


def row(scene: Scene, name: str, schedule: Schedule | None, each: list[Scores]) -> dict[str, Any]:
    """One line of the table: mean scores, and the loss on each held-out frame."""
    return {
        "scene": scene.name,
        "name": name,
        "schedule": None if schedule is None else schedule.name,
        "steps": None if schedule is None else steps_text(schedule),
        "kappa": None if schedule is None else kappa_text(schedule),
        "lam": None if schedule is None else lam_text(schedule),
        "losses": [scores.loss for scores in each],
    } | dataclasses.asdict(mean_scores(each))


def markdown(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| scene | held-out frames | steps | median ms | p95 ms | loss | PSNR dB | SSIM |",
        "|---|---|---|---:|---:|---:|---:|---:|",
    ]
    for r in rows:
        times = f"{r['again']['median']:.2f} | {r['again']['p95']:.2f}" if r["again"] else "– | –"
        lines.append(
            f"| {r['scene']} | {label(r)} | {r['steps'] or '–'} | {times} | {r['loss']:.5f} | {r['psnr']:.2f} "
            f"| {r['ssim']:.4f} |"
        )
    return lines


def label(row: dict[str, Any]) -> str:
    """The name; with the schedule's own where nothing tuned came out in time and another stands in."""
    stands_in = row["name"].startswith("tuned") and not row["schedule"].startswith("tuned")
    return f"{row['name']} ({row['schedule']})" if stands_in else row["name"]


def figure(rows: list[dict[str, Any]]) -> Figure:
    """Held-out loss of every schedule, each frame a small dot, with its median time."""
    scenes = list(dict.fromkeys(r["scene"] for r in rows))
    fig = new_figure(2.0 + 4.2 * len(scenes), 4.5)
    for axes, scene in zip(fig.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        own = [r for r in rows if r["scene"] == scene]
        for y, r in enumerate(own):
            color = next((c for kind, c in KINDS.items() if r["name"].startswith(kind)), "0.5")
            axes.plot(r["losses"], [y] * len(r["losses"]), ".", color=color, alpha=0.35)
            axes.plot(r["loss"], y, "o", color=color)
        texts = [f"{label(r)}\n{r['again']['median']:.2f} ms" if r["again"] else label(r) for r in own]
        axes.set_yticks(range(len(own)), texts, fontsize=8)
        axes.invert_yaxis()
        axes.grid(axis="x", color="0.9")
        axes.set(xscale="log", xlabel="loss on held-out frames: mean, and each frame", title=scene)
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    return fig


KINDS = {"tuned": "C0", "paper": "C1", "naive": "C2"}


if __name__ == "__main__":
    run(main, Config)
