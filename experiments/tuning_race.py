"""Loss reached against wall time: our search, two of Optuna's and random search, inside the same budget.

    pip install -e ".[experiments]"
    python -m experiments.tuning_race [--budget-ms 4] [--seconds 60] [--seeds 5] [--out results/tuning_race]

Takes methods x seeds x seconds, 20 minutes by default on two cores, once the built-in room and its latency table
are made; leave the machine alone meanwhile. The methods run one after another, seed by seed, on the same objective
(the default tuning frames) and the same cost model (95th percentile by the latency table). All start cold, but ours
knows the defaults of κ, λ and α and tries them first. The loss and its gradient are compiled before any clock
starts; whatever else a method compiles is on its clock.

- Ours: `Search` with its default effort, which may end before the time is up. Its relaxed, real-valued plans are
  not schedules and do not count; neither does anything that comes in after the time.
- Optuna's TPE and NSGA-II, in their default settings with the budget as a constraint: whole steps from 0 to 64 for
  each level of the ladder, κ and α on logarithmic scales and λ in the ranges that ours has. A trial over the budget
  is recognised before it is evaluated and costs them next to nothing; its value is not looked at, only by how much
  it is over.
- Random search: uniform in the same space, redrawn until within the budget.

`--resume` goes on with the runs that are left.

Expect: random search ahead in the first seconds, for few steps do well and the loss is flat; ours best in the end,
once its starting points are relaxed; TPE last, which spends its time on getting into the budget.
"""

import dataclasses
import functools
import importlib.util
import itertools
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind
from experiments.tuning_optimum import Counted, prepare_room, warm_up
from hyjax.tuning.budget import MOST_STEPS, fits, single_steps
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.relaxation import FIDELITY_RANGE, KAPPA_RANGE, LAM_RANGE, RelaxedSchedule
from hyjax.tuning.search import Search
from hyjax.util.clock import Stopwatch
from hyjax.util.errors import InputError

DRAWS = 20_000
OVER_BUDGET = 1.0
"""Stands for the loss of what does not fit; with constraints no sampler compares it with any other."""


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    budget_ms: float = 4.0
    seconds: float = 60.0
    """For each method and seed."""
    seeds: int = 5
    seed: int = 0
    """The first of them; the others follow."""
    size: int = 512
    """Side of the pictures, in pixels."""
    frames: int = 4
    """How many of the default tuning frames, at most four."""
    recalibrate: bool = False
    """Make the latency table anew."""
    resume: bool = False


class Run:
    """One method with one seed against the clock.

    Args:
        objective: what it minimises.
        cost: milliseconds of a schedule.
        budget: what these have to stay within.
        seed: of the method.
        seconds: after which nothing counts any more.
        bar: progress in seconds.
    """

    def __init__(
        self, objective: Counted, cost: CostModel, budget: float, seed: int, seconds: float, bar: tqdm
    ) -> None:
        self.objective, self.cost, self.budget, self.seed, self.seconds = objective, cost, budget, seed, seconds
        self.curve: list[tuple[float, float]] = []
        """(seconds, best loss so far), an entry for each improvement."""
        self.best, self.over_budget = math.inf, 0
        objective.frames.clear()
        self.bar, self.shown, self.clock = bar, 0.0, Stopwatch()

    def expired(self) -> bool:
        now = min(self.clock.seconds, self.seconds)
        self.bar.update(now - self.shown)
        self.shown = now
        return now >= self.seconds

    def note(self, loss: float) -> None:
        """A schedule within the budget has this loss."""
        if not self.expired() and loss < self.best:
            self.best = loss
            self.curve.append((self.clock.seconds, loss))

    def evaluate(self, steps: list[int], kappa: list[float], lam: list[float], fidelity: list[float]) -> float:
        quarters = 4.0 * np.array(lam)
        free = np.log(kappa), np.log(quarters) - np.log1p(-quarters), np.log(fidelity)
        parts = np.array(steps), *free
        loss = self.objective(RelaxedSchedule(*(jnp.asarray(part, jnp.float32) for part in parts)))
        self.note(loss)
        return loss

    def result(self, method: str) -> dict[str, Any]:
        seconds, count = self.clock.seconds, len(self.objective.prepared)
        self.bar.update(self.seconds - self.shown)
        return {
            "method": method,
            "run_seed": self.seed,
            "seconds": seconds,
            "loss": self.best,
            "evaluations": self.objective.frames["loss"] / count,
            "gradients": self.objective.frames["gradient"] / count,
            "over_budget": self.over_budget,
            "curve": self.curve,
        }


# ---- methods ----


def ours(run: Run) -> None:
    def report(phase: str, loss: float) -> None:
        if phase != "relax":
            run.note(loss)

    search = Search(run.objective, run.cost, seed=run.seed, report=report, expired=run.expired)
    search.run(run.budget)


def optuna_search(run: Run, sampler: str) -> None:
    import optuna

    def loss(trial: optuna.Trial) -> float:
        ladder = run.objective.factors
        steps = [trial.suggest_int(f"steps {factor}", 0, MOST_STEPS) for factor in ladder]
        kappa = [trial.suggest_float(f"kappa {factor}", *KAPPA_RANGE, log=True) for factor in ladder]
        lam = [trial.suggest_float(f"lam {factor}", *LAM_RANGE) for factor in ladder]
        fidelity = [trial.suggest_float(f"alpha {factor}", *FIDELITY_RANGE, log=True) for factor in ladder]
        over = run.cost(steps) - run.budget if any(steps) else run.budget
        trial.set_user_attr("over", over)
        if over > 0:
            run.over_budget += 1
            run.expired()
            return OVER_BUDGET
        return run.evaluate(steps, kappa, lam, fidelity)

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        # Optuna 5 has another way to say it, Optuna 4 has only this one.
        warnings.filterwarnings("ignore", message=".*constraints_func.*")
        make = getattr(optuna.samplers, sampler)
        study = optuna.create_study(
            sampler=make(seed=run.seed, constraints_func=lambda trial: (trial.user_attrs["over"],))
        )
        study.optimize(loss, timeout=run.seconds)


def random_search(run: Run) -> None:
    rng, size = np.random.default_rng(run.seed), len(run.objective.factors)
    while not run.expired():
        draws = rng.integers(0, MOST_STEPS + 1, (DRAWS, size))
        # What levels and steps cost alone tells most of those that do not fit, all at once.
        least = run.cost.fixed + (draws > 0) @ np.array(run.cost.level) + draws @ np.array(run.cost.step)
        left = draws[least <= run.budget].tolist()
        fitting = [steps for steps in left if fits(steps, run.cost, run.budget)]
        run.over_budget += len(draws) - len(fitting)
        for steps in fitting:
            if run.expired():
                break
            kappa, fidelity = (
                np.exp(rng.uniform(*np.log(bounds), size)).tolist() for bounds in (KAPPA_RANGE, FIDELITY_RANGE)
            )
            run.evaluate(steps, kappa, rng.uniform(*LAM_RANGE, size).tolist(), fidelity)


OURS = "ours"
METHODS: dict[str, Callable[[Run], None]] = {
    OURS: ours,
    "Optuna TPE": functools.partial(optuna_search, sampler="TPESampler"),
    "Optuna NSGA-II": functools.partial(optuna_search, sampler="NSGAIISampler"),
    "random": random_search,
}


@experiment("The search against Optuna and chance")
def main(config: Config, start: Start) -> None:
    if importlib.util.find_spec("optuna") is None:
        raise InputError('optuna is not installed; pip install -e ".[experiments]"')
    if not (config.seeds >= 1 and config.seconds > 0):
        raise InputError(f"need at least 1 seed and > 0 seconds, got {config.seeds} and {config.seconds:g}")
    results = start()
    prepared, ladder, cost = prepare_room(results, config.size, config.frames, recalibrate=config.recalibrate)
    objective, singles = Counted(prepared, ladder), single_steps(len(ladder))
    if not any(fits(steps, cost, config.budget_ms) for steps in singles):
        least = min(cost(steps) for steps in singles)
        raise InputError(
            f"budget: no schedule takes {config.budget_ms:g} ms or less; the fastest takes {least:.2f}"
        )
    warm_up(objective, cost)
    import optuna  # noqa: F401  before any clock starts

    done = [(row["run_seed"], row["method"]) for row in of_kind(results.rows, "run")]
    runs = itertools.product(range(config.seed, config.seed + config.seeds), METHODS)
    left = [run for run in runs if run not in done]
    form = "{desc}: {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s"
    with tqdm(total=len(left) * config.seconds, bar_format=form) as bar:
        for seed, method in left:
            bar.set_description(f"{method}, seed {seed}")
            run = Run(objective, cost, config.budget_ms, seed, config.seconds, bar)
            METHODS[method](run)
            results.add(kind="run", **run.result(method))


def reached(curve: list[tuple[float, float]], loss: float) -> float:
    """Seconds until a loss was reached; infinite if it never was."""
    return next((seconds for seconds, value in curve if value <= loss), math.inf)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    runs = of_kind(rows, "run")
    if not runs:
        return ["No method has run yet."]
    mine = {row["run_seed"]: row["curve"] for row in runs if row["method"] == OURS}
    lines = []
    for method in METHODS:
        own = [row for row in runs if row["method"] == method and row["run_seed"] in mine]
        if not own:
            continue
        losses = [math.inf if row["loss"] is None else row["loss"] for row in own]
        there = _seconds([reached(mine[row["run_seed"]], loss) for row, loss in zip(own, losses)])
        spent = [
            f"{np.median([row[name] for row in own]):.0f}" for name in ("evaluations", "gradients", "over_budget")
        ]
        ends = f"{min(losses):.5f} to {max(losses):.5f}"
        lines.append([method, f"{np.median(losses):.5f}", ends, there, *spent])
    header = [
        *("method", "final loss, median", "min to max", "ours there after"),
        *("evaluations", "gradients", "over budget"),
    ]
    settings = runs[0]["settings"]
    ended = _seconds([row["seconds"] for row in runs if row["method"] == OURS])
    caption = (
        f"Budget {settings['budget_ms']:g} ms, {len(mine)} seeds, {settings['seconds']:g} s each; ours ended "
        f"after {ended}. Medians over seeds. Evaluations and gradients are of all {settings['frames']} frames; "
        f"what is over the budget is not evaluated; {machine(runs[0])}."
    )
    return [
        Table(caption, header, lines),
        Plot(main.name, "Best loss so far: median and range of the seeds.", figure(runs)),
    ]


def _seconds(times: list[float]) -> str:
    """Median and range, in words."""
    low, middle, high = (
        f"{value:.1f} s" if math.isfinite(value) else "never"
        for value in (min(times), np.median(times), max(times))
    )
    return f"{middle} ({low} to {high})"


def figure(runs: Sequence[Row]) -> Figure:
    """Best loss so far against wall time by method: median and range of the seeds."""
    seconds = runs[0]["settings"]["seconds"]
    fig = new_figure(7, 4.5)
    axes = fig.subplots()
    first = min((row["curve"][0][0] for row in runs if row["curve"]), default=0.1)
    times = np.geomspace(min(first, 0.5 * seconds), seconds, 400)
    for method in dict.fromkeys(row["method"] for row in runs):
        curves = []
        for row in (row for row in runs if row["method"] == method):
            at, losses = np.array([(0.0, math.inf), *row["curve"]]).T
            curves.append(losses[np.searchsorted(at, times, side="right") - 1])
        low, middle, high = (f(curves, axis=0) for f in (np.min, np.median, np.max))
        line = axes.plot(times, np.where(np.isfinite(middle), middle, np.nan), label=method)[0]
        axes.fill_between(
            times, low, high, where=np.isfinite(high), color=line.get_color(), alpha=0.15, linewidth=0
        )
    axes.set(xscale="log", yscale="log", xlabel="wall time, s", ylabel="best loss so far")
    axes.minorticks_on()
    axes.xaxis.set_major_formatter("{x:g}")
    for format_ticks in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        format_ticks("{x:.3g}")
    axes.tick_params(which="minor", labelsize=7)
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
