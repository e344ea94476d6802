"""Distance of our search from the true optimum, where that can be had by trying everything.

    python -m experiments.tuning_optimum [--size 512] [--frames 2] [--out results/tuning_optimum]

Takes about four minutes on two cores, once the built-in room is made. On the paper's ladder with eight step counts
a level, all 4095 schedules are evaluated, once: each budget's optimum on this grid is known for sure. The search
gets the same objective, cost model and budgets, and the same fixed κ, λ and α; its step counts may be any whole
numbers. Two kinds of regret, relative to the loss of the grid's optimum:

- of what it found, below zero where finer step counts help;
- of that rounded down to the grid, which leaves unspent what the rounding freed. Next to it the best of all ways to
  round, down or up level by level, that fit: near zero if the search was in the right place.

Both wall times are given; compilation is before either. `--resume` goes on with the budgets that are left.

Expect: a regret of what was found within one percent of zero, for each budget in a tenth of brute force's
evaluations. With the default κ the best schedules have few steps, and more time than those take is of no use.
"""

import collections
import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Results, Row, machine, of_kind
from hyjax.core.schedule import DEFAULT_LAM, GUIDED_FIDELITY, GUIDED_KAPPA
from hyjax.data.frames import spread
from hyjax.tuning.bench import open_bench
from hyjax.tuning.budget import MOST_STEPS, Steps, fits, project
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.descent import Objective
from hyjax.tuning.latency_estimator import workload_of
from hyjax.tuning.latency_table import load_table
from hyjax.tuning.relaxation import RelaxedSchedule, prepare
from hyjax.tuning.request import TUNING_FRAMES, split_frames
from hyjax.tuning.search import Effort, Search
from hyjax.tuning.settings import TuneScene, TuneSettings
from hyjax.tuning.workload import FACTORS
from hyjax.util.clock import Stopwatch
from hyjax.util.errors import InputError

EFFORT = Effort(polished=0, polishing=0)


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    size: int = 512
    """Side of the pictures, in pixels."""
    frames: int = 2
    """How many of the default tuning frames, at most four."""
    ladder: tuple[int, ...] = (16, 8, 4, 2)
    counts: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 24, 32)
    """Steps that a level of the grid may have; 0 and 1 must be among them."""
    budgets: int = 5
    """How many, evenly spread in ratio from the cheapest schedule of the grid to its best, the last budget."""
    kappa: float = GUIDED_KAPPA
    lam: float = DEFAULT_LAM
    fidelity: float = GUIDED_FIDELITY
    recalibrate: bool = False
    """Make the latency table anew."""
    seed: int = 0
    resume: bool = False


@dataclasses.dataclass(frozen=True)
class Counted(Objective):
    """The objective, counting the frames that it is evaluated on."""

    frames: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)

    def __call__(self, plan: RelaxedSchedule) -> float:
        self.frames["loss"] += len(self.prepared)
        return super().__call__(plan)

    def gradient(self, plan: RelaxedSchedule, frames: Iterable[int] | None = None) -> tuple[float, RelaxedSchedule]:
        chosen = range(len(self.prepared)) if frames is None else list(frames)
        self.frames["gradient"] += len(chosen)
        return super().gradient(plan, chosen)


@dataclasses.dataclass(frozen=True)
class StepsOnly(Counted):
    """Objective of a plan's steps alone: κ, λ and α are fixed, so its slopes in them are zero."""

    kappa: float = GUIDED_KAPPA
    lam: float = DEFAULT_LAM
    fidelity: float = GUIDED_FIDELITY

    def fixed(self, plan: RelaxedSchedule) -> RelaxedSchedule:
        return RelaxedSchedule.of(np.asarray(plan.steps), self.kappa, self.lam, self.fidelity)

    def __call__(self, plan: RelaxedSchedule) -> float:
        return super().__call__(self.fixed(plan))

    def gradient(self, plan: RelaxedSchedule, frames: Iterable[int] | None = None) -> tuple[float, RelaxedSchedule]:
        loss, slope = super().gradient(self.fixed(plan), frames)
        zero = jax.tree.map(np.zeros_like, slope)
        return loss, dataclasses.replace(zero, steps=slope.steps)


def prepare_room(
    results: Results, size: int, frames: int, ladder: Sequence[int] = FACTORS, recalibrate: bool = False
) -> tuple[list[Any], tuple[int, ...], CostModel]:
    """The built-in room's tuning frames, prepared; the ladder; what schedules on it cost (95th percentile).

    A row says what was used; where it is there already, ladder and costs are taken from it.

    Raises:
        InputError: not so many tuning frames, or a size or ladder that no schedule can have.
    """
    if not 1 <= frames <= TUNING_FRAMES:
        raise InputError(f"frames: give 1 to {TUNING_FRAMES} of the tuning frames, got {frames}")
    if size < 16:
        raise InputError(f"size: must be at least 16 pixels, got {size}")
    bench = open_bench(TuneSettings(TuneScene(size=str(size))))
    tuning, _ = split_frames(len(bench.scene), None, None)
    chosen = spread(tuning, frames)
    cases, _ = bench.cases(chosen, "tuning")
    earlier = of_kind(results.rows, "bench")
    if not earlier:
        table, _ = load_table(workload_of(cases[0]), ladder, recalibrate=recalibrate)
        names = [bench.name(i) for i in chosen]
        cost = dataclasses.asdict(table.p95)
        earlier = [results.add(kind="bench", frames=names, ladder=table.factors, cost_ms=cost)]
    used = tuple(earlier[0]["ladder"])
    return [prepare(case, used) for case in cases], used, CostModel(**earlier[0]["cost_ms"])


def warm_up(objective: Objective, cost: CostModel) -> None:
    """Compile everything that is compiled once in a process: loss, gradient and projection."""
    plan = RelaxedSchedule.of([1] * len(objective.factors))
    objective(plan)
    objective.gradient(plan)
    project(
        np.full(len(objective.factors), MOST_STEPS / 2), cost, 0.7 * cost([MOST_STEPS / 2] * len(objective.factors))
    )


@experiment("The search against the true optimum")
def main(config: Config, start: Start) -> None:
    counts = sorted(set(config.counts))
    if counts[:2] != [0, 1] or counts[-1] > MOST_STEPS:
        raise InputError(f"counts: need 0, 1 and others up to {MOST_STEPS}, got {counts}")
    if config.budgets < 1:
        raise InputError(f"budgets: must be at least 1, got {config.budgets}")
    results = start()
    prepared, ladder, cost = prepare_room(results, config.size, config.frames, config.ladder, config.recalibrate)
    fixed = {name: getattr(config, name) for name in ("kappa", "lam", "fidelity")}
    objective = StepsOnly(prepared, ladder, **fixed)
    warm_up(objective, cost)

    grid = [steps for steps in itertools.product(counts, repeat=len(ladder)) if any(steps)]
    if not of_kind(results.rows, "brute force"):
        watch = Stopwatch()
        found = [objective(RelaxedSchedule.of(steps)) for steps in tqdm(grid, "brute force", unit="schedule")]
        costs = [cost(steps) for steps in grid]
        results.add(kind="brute force", seconds=watch.seconds, losses=found, costs_ms=costs)
    (brute,) = of_kind(results.rows, "brute force")
    losses: dict[Steps, float] = dict(zip(grid, brute["losses"], strict=True))

    dearest = cost(min(losses, key=losses.__getitem__))  # a larger budget would not bind
    budgets = [*np.geomspace(min(brute["costs_ms"]), dearest, config.budgets + 1)[1:-1].tolist(), dearest]
    done = [row["budget_ms"] for row in of_kind(results.rows, "budget")]
    for budget in tqdm([budget for budget in budgets if budget not in done], "search"):
        results.add(kind="budget", **compare(budget, losses, counts, cost, objective, config.seed))


def compare(
    budget: float, losses: dict[Steps, float], counts: list[int], cost: CostModel, objective: StepsOnly, seed: int
) -> dict[str, Any]:
    """One budget: the grid's optimum, ours, and ours brought to the grid."""
    optimum = min((steps for steps in losses if fits(steps, cost, budget)), key=losses.__getitem__)
    objective.frames.clear()
    watch = Stopwatch()
    ours = Search(objective, cost, seed=seed).run(budget, EFFORT)[0].point
    seconds, frames = watch.seconds, dict(objective.frames)
    steps = tuple(int(n) for n in np.asarray(ours.steps))
    down = tuple(max(k for k in counts if k <= n) for n in steps)
    around = [{below, min((k for k in counts if k >= n), default=below)} for n, below in zip(steps, down)]
    roundings = [near for near in itertools.product(*around) if fits(near, cost, budget)]
    nearest = min(roundings, key=losses.__getitem__)
    # Evaluated once more because the search may keep the gradient's loss, which differs in the last digit.
    loss, best = objective(ours), losses[optimum]
    return {
        "budget_ms": budget,
        "brute_force": {"steps": optimum, "loss": best, "cost_ms": cost(optimum)},
        "ours": {
            "steps": steps,
            "loss": loss,
            "cost_ms": cost(steps),
            "regret": loss / best - 1,
            "seconds": seconds,
            "frames_evaluated": frames,
        },
        "rounded_down": _on_grid(down, losses, cost, best),
        "best_rounding": _on_grid(nearest, losses, cost, best),
    }


def _on_grid(steps: Steps, losses: dict[Steps, float], cost: CostModel, best: float) -> dict[str, Any]:
    return {"steps": steps, "loss": losses[steps], "cost_ms": cost(steps), "regret": losses[steps] / best - 1}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    if not of_kind(rows, "brute force"):
        return ["Nothing but the machine has been looked at yet."]
    (bench,), (brute,), budgets = (of_kind(rows, kind) for kind in ("bench", "brute force", "budget"))
    lines = []
    for row in budgets:
        cells = [f"{row['budget_ms']:.2f}"]
        for name in ("brute_force", "ours", "rounded_down", "best_rounding"):
            entry = row[name]
            cells.append(" ".join(map(str, entry["steps"])))
            cells += [f"{entry['loss']:.5f}"] if name in ("brute_force", "ours") else []
            cells += [f"{100 * entry['regret']:+.2f} %"] if "regret" in entry else []
        spent = row["ours"]["frames_evaluated"]
        cells += [f"{spent.get(name, 0) / len(bench['frames']):.0f}" for name in ("loss", "gradient")]
        lines.append([*cells, f"{row['ours']['seconds']:.1f}"])
    header = [
        *("budget, ms", "brute force", "loss", "ours", "loss", "regret", "rounded down", "regret"),
        *("best rounding", "regret", "evaluations", "gradients", "seconds"),
    ]
    total = sum(row["ours"]["seconds"] for row in budgets)
    caption = (
        f"Brute force: {len(brute['losses'])} schedules in {brute['seconds']:.0f} s, once for all budgets. "
        f"Ours: {total:.0f} s for {len(budgets)} budgets. Evaluations and gradients are of all "
        f"{len(bench['frames'])} frames; {machine(brute)}."
    )
    size = bench["settings"]["size"]
    shown = f"Steps at {size} pixels over the ladder {' '.join(map(str, bench['ladder']))}, all of them and ours."
    return [Table(caption, header, lines), Plot(main.name, shown, figure(brute, budgets))]


def figure(brute: Row, budgets: Sequence[Row]) -> Figure:
    """Loss against cost of every schedule of the grid, its front, and what the search found."""
    fig = new_figure(7, 4.5)
    axes = fig.subplots()
    costs, losses = np.array(brute["costs_ms"]), np.array(brute["losses"])
    axes.scatter(
        costs, losses, s=3, color="0.75", linewidths=0, label="every schedule of the grid", rasterized=True
    )
    order = np.lexsort((losses, costs))
    front = np.minimum.accumulate(losses[order])
    axes.step(costs[order], front, where="post", color="black", linewidth=1, label="brute-force front")
    for name, style, label in (
        ("rounded_down", {"marker": "v", "markerfacecolor": "none", "color": "tab:blue"}, "ours, rounded down"),
        ("ours", {"marker": "o", "color": "tab:red"}, "ours"),
    ):
        found = [row[name] for row in budgets]
        x, y = ([entry[key] for entry in found] for key in ("cost_ms", "loss"))
        axes.plot(x, y, linestyle="none", markersize=6, label=label, **style)
    for row in budgets:
        axes.axvline(row["budget_ms"], color="0.6", linewidth=0.6, linestyle=":", zorder=0)
    axes.set(xscale="log", yscale="log")
    axes.set(xlabel="predicted 95th percentile, ms (dotted: budgets)", ylabel="loss on tuning frames")
    axes.minorticks_on()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.tick_params(which="minor", labelsize=7)
    axes.legend(markerscale=1.0)
    return fig


if __name__ == "__main__":
    run(main)
