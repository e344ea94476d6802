"""What it costs to use a schedule in another room than it was tuned in.

    python -m experiments.tuning_transfer --kitchen PATH [--budget-ms 4] [--out results/tuning_transfer]

Tunes once on the built-in room and once on the capture, at the same budget, and judges both schedules, and
`paper-80` with our default κ and λ, on held-out frames (of the last quarter) of both. All times are taken afresh at
the end, in turns. Takes about ten minutes on two cores. Writes `tuning_transfer.json`, `.md` and `.png`.

Expect: the schedule tuned elsewhere within a few percent of the scene's own loss, on either side, and ahead of
`paper-80`.
"""

import dataclasses
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.command import run
from experiments.plotting import new_figure
from experiments.tuning_scenes import (
    ComparisonConfig,
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
from hyjax.tuning.cases import mix, refined_filter
from hyjax.tuning.report_text import kappa_text, lam_text, steps_text
from hyjax.tuning.request import parse_budgets
from hyjax.tuning.run import tune_bench


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(ComparisonConfig):
    kitchen: Path
    """The capture to tune on besides the built-in room."""
    budget_ms: float = 4.0
    out: Path = Path("results/tuning_transfer")


def main(config: Config) -> None:
    make_writable(config.out)
    budgets = parse_budgets((), (config.budget_ms,))
    scenes = open_scenes(config.kitchen, config.size, config.frames, config.holdout)
    schedules = {}
    for scene in scenes:
        found = tune_bench(
            scene.bench, budgets, frames=scene.frames, seed=config.seed, effort=config.effort, extra=False
        ).schedule
        if not found.name.startswith("tuned"):
            raise InputError(f"{scene.name}: nothing tuned came out within {config.budget_ms:g} ms; give more")
        schedules[f"tuned on {scene.name}"] = found
    schedules["paper-80"] = Schedule.preset("paper-80")

    rows: list[dict[str, Any]] = []
    comparisons = []
    for scene in scenes:
        held, _ = scene.bench.cases(scene.holdout, "held-out")
        judged = {"raw filter": score_each(held, [mix(case.shading, case.colors) for case in held])}
        for name, schedule in schedules.items():
            judged[name] = score_each(held, [refined_filter(case, schedule) for case in held])
        rows += [
            {"scene": scene.name, "name": name, "own": name.endswith(f" {scene.name}")}
            | dataclasses.asdict(mean_scores(each))
            | {"losses": [scores.loss for scores in each]}
            for name, each in judged.items()
        ]
        own = f"tuned on {scene.name}"
        comparisons += [
            {"scene": scene.name} | compare(name, judged[name], own, judged[own])
            for name in schedules
            if name != own
        ]
    (times,) = retime([(held[0], list(schedules.values()))], config.repeats)
    timed = dict(zip(schedules, times, strict=True))
    for entry in comparisons:
        entry["time_ratio"] = timed[entry["schedule"]].median / timed[entry["against"]].median
    record = {
        "rows": rows,
        "comparisons": comparisons,
        "schedules": {
            name: {
                "steps": steps_text(schedule),
                "kappa": kappa_text(schedule),
                "lam": lam_text(schedule),
                "again": dataclasses.asdict(timed[name]),
            }
            for name, schedule in schedules.items()
        },
        "scenes": [scene.record() for scene in scenes],
        "config": str(config),
    }
    table = [*markdown(record), "", *comparison_table(comparisons), *footer(scenes, config.size)]
    write_results(config.out, "tuning_transfer", record, table, figure(record))


def markdown(record: dict[str, Any]) -> list[str]:
    lines = ["| schedule | steps | κ | λ | median ms | p95 ms |", "|---|---|---|---|---:|---:|"]
    for name, s in record["schedules"].items():
        times = f"{s['again']['median']:.2f} | {s['again']['p95']:.2f}"
        lines.append(f"| {name} | {s['steps']} | {s['kappa']} | {s['lam']} | {times} |")
    lines += ["", "| held-out frames of | schedule | loss | PSNR dB | SSIM |", "|---|---|---:|---:|---:|"]
    for r in record["rows"]:
        name = f"**{r['name']}**" if r["own"] else r["name"]
        lines.append(f"| {r['scene']} | {name} | {r['loss']:.5f} | {r['psnr']:.2f} | {r['ssim']:.4f} |")
    return lines


def figure(record: dict[str, Any]) -> Figure:
    """Held-out loss by scene and schedule, each frame a small dot."""
    scenes = list(dict.fromkeys(r["scene"] for r in record["rows"]))
    fig = new_figure(2.0 + 3.5 * len(scenes), 2.6)
    for axes, scene in zip(fig.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        own = [r for r in record["rows"] if r["scene"] == scene]
        for y, r in enumerate(own):
            color = "C0" if r["own"] else "C1" if r["name"].startswith("tuned") else "0.5"
            axes.plot(r["losses"], [y] * len(r["losses"]), ".", color=color, alpha=0.35)
            axes.plot(r["loss"], y, "o", color=color)
        again = {name: s["again"]["median"] for name, s in record["schedules"].items()}
        names = [f"{r['name']}\n{again[r['name']]:.2f} ms" if r["name"] in again else r["name"] for r in own]
        axes.set_yticks(range(len(own)), names, fontsize=8)
        axes.margins(y=0.15)
        axes.invert_yaxis()
        axes.grid(axis="x", color="0.9")
        axes.set(xlabel="loss on held-out frames: mean, and each frame", title=scene)
    return fig


if __name__ == "__main__":
    run(main, Config)
