"""Quality reached against trials: our search of whole frames, Optuna's TPE and NSGA-II, and chance.

    pip install -e ".[tune]"
    python -m experiments.frame_race [--trials 30] [--others 300] [--seeds 5] [--out results/frame_race] [--resume]

All search the same space (`hyjax.tuning.frame.space`) on the same frames for the least loss at the default's
frame time. All begin with the default. A trial is one evaluation of all frames; of ours, so is each iteration of a
refinement by gradients. Optuna's samplers have their default settings and the budget as a constraint on the
measured time. What was evaluated before, by whatever method, is not evaluated again: trials are counted, not
seconds. Takes some hours on two cores, most of them to compile, and renders two rooms first.

Expect: ours after 30 trials where TPE and NSGA-II are after 300. That is what it is to show: it was not run at this
size yet.
"""

import dataclasses
import functools
import importlib.util
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind
from hyjax.data.frames import spread
from hyjax.tuning.frame.clock import FrameClock
from hyjax.tuning.frame.evaluation import Judge
from hyjax.tuning.frame.evaluator import StudyEvaluator
from hyjax.tuning.frame.loss import PictureLoss
from hyjax.tuning.frame.refinement import ITERATIONS
from hyjax.tuning.frame.scene import open_room, spread_cases
from hyjax.tuning.frame.search import FrameSearch, Trial
from hyjax.tuning.frame.space import Choices, Space, key_of, structure
from hyjax.tuning.frame.study import Study
from hyjax.tuning.settings import SETUPS
from hyjax.util.errors import InputError

OURS = "ours"
OVER = 1.0
"""Log of the loss that stands for what does not fit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    rooms: tuple[str, ...] = ("builtin-0", "random-11-0-both")
    size: str = "160x120"
    frames: int = 3
    """Cases: frames of the two rooms, each under another set-up."""
    trials: int = 30
    """Of ours."""
    others: int = 300
    """Of the others."""
    seeds: int = 5
    resume: bool = False


class Known:
    """Losses and times of choices, evaluated once each.

    Args:
        evaluator: evaluates.
        space: of the choices.
        cases: how many.
    """

    def __init__(self, evaluator: StudyEvaluator, space: Space, cases: int) -> None:
        self.evaluator, self.space, self.cases = evaluator, space, cases
        self._losses: dict[str, list[float]] = {}
        self._times: dict[str, float] = {structure(space.default, space): 1.0}

    def losses(self, choices: Choices, first: int, last: int) -> list[float]:
        key = key_of(choices)
        if key not in self._losses:
            self._losses[key] = self.evaluator.losses(choices, 0, self.cases)
        return self._losses[key][first:last]

    def time(self, choices: Choices) -> float:
        key = structure(choices, self.space)
        if key not in self._times:
            self._times[key] = self.evaluator.time(choices)
        return self._times[key]

    def refine(self, choices: Choices, batch: int) -> Choices:
        return self.evaluator.refine(choices, batch)

    def loss(self, choices: Choices) -> float:
        """Logarithm of the mean loss relative to the default's."""
        return float(np.mean(np.log(self.losses(choices, 0, self.cases))))


class Curve:
    """Best loss within the time so far, by trials."""

    def __init__(self, known: Known) -> None:
        self.known, self.trials, self.best = known, 0, math.inf
        self.points: list[tuple[int, float]] = []

    def count(self, loss: float, time: float, trials: int = 1) -> None:
        """Trials with the result of the last."""
        self.trials += trials
        if time <= 1.0 and loss < self.best:
            self.best = loss
            self.points.append((self.trials, loss))


# ---- methods ----


def ours(known: Known, count: int, seed: int) -> Curve:
    curve = Curve(known)

    def report(trial: Trial) -> None:
        more = ITERATIONS + 1 if trial.phase == "ranges" else 0
        curve.count(math.log(trial.loss), trial.time or math.inf, 1 + more)

    search = FrameSearch(known.space, known, [known.cases], seed=seed, report=report)
    search.run([1.0], max(count - ITERATIONS - 1, 4))
    return curve


def optuna_search(known: Known, count: int, seed: int, *, sampler: str) -> Curve:
    import optuna

    curve, space = Curve(known), known.space

    def objective(trial: optuna.Trial) -> float:
        choices: Choices = {p.name: p.default for p in space.parameters}
        for p in space.parameters:  # those that mean nothing beside the others are not asked for
            if not p.active(choices):
                continue
            if p.continuous:
                choices[p.name] = trial.suggest_float(p.name, *p.values, log=True)
            else:
                choices[p.name] = trial.suggest_categorical(p.name, p.values)
        choices = space.complete(choices)
        time, loss = known.time(choices), known.loss(choices)
        trial.set_user_attr("over", time - 1.0)
        curve.count(loss, time)
        return loss

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        make = getattr(optuna.samplers, sampler)
        study = optuna.create_study(
            sampler=make(seed=seed, constraints_func=lambda trial: (trial.user_attrs["over"],))
        )
        study.enqueue_trial(space.default)
        study.optimize(objective, n_trials=count)
    return curve


def chance(known: Known, count: int, seed: int) -> Curve:
    curve, rng = Curve(known), np.random.default_rng(seed)
    for number in range(count):
        choices = known.space.random(rng) if number else known.space.default
        curve.count(known.loss(choices), known.time(choices))
    return curve


METHODS: dict[str, Callable[[Known, int, int], Curve]] = {
    OURS: ours,
    "Optuna TPE": functools.partial(optuna_search, sampler="TPESampler"),
    "Optuna NSGA-II": functools.partial(optuna_search, sampler="NSGAIISampler"),
    "chance": chance,
}


@experiment("The search of whole frames against Optuna and chance")
def main(config: Config, start: Start) -> None:
    if importlib.util.find_spec("optuna") is None:
        raise InputError('optuna is not installed; pip install -e ".[tune]"')
    if min(config.seeds, config.trials, config.others, config.frames) < 1 or not config.rooms:
        raise InputError("need at least one room, frame, seed and trial")
    results = start()
    scenes = [open_room(room, config.size) for room in config.rooms]
    frames = [spread(range(len(scene)), config.frames) for scene in scenes]
    cases = spread_cases(frames, SETUPS, 0)[: config.frames * len(scenes)]
    space = Space.of(truth=True)
    study = Study(None, "race", {})
    judge, clock = Judge(scenes, PictureLoss()), FrameClock(scenes[0], SETUPS[0])
    known = Known(StudyEvaluator(space, judge, cases, clock, study), space, len(cases))
    done = {(row["method"], row["run_seed"]) for row in of_kind(results.rows, "run")}
    runs = [(method, seed) for seed in range(config.seeds) for method in METHODS if (method, seed) not in done]
    for method, seed in tqdm(runs, "race", unit="run"):
        curve = METHODS[method](known, config.trials if method == OURS else config.others, seed)
        points = [[count, math.exp(loss)] for count, loss in curve.points]
        results.add(kind="run", method=method, run_seed=seed, trials=curve.trials, curve=points)


def at(curve: Sequence[Sequence[float]], trials: int) -> float:
    """Best loss after so many trials."""
    return min((loss for count, loss in curve if count <= trials), default=math.inf)


def reached(curve: Sequence[Sequence[float]], loss: float) -> float:
    """Trials until a loss was reached; infinite if it never was."""
    return next((count for count, value in curve if value <= loss), math.inf)


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    runs = of_kind(rows, "run")
    if not runs:
        return ["No method has run yet."]
    settings = runs[0]["settings"]
    count, lines = settings["trials"], []
    mine = {row["run_seed"]: at(row["curve"], 10**9) for row in runs if row["method"] == OURS}
    for method in METHODS:
        own = [row for row in runs if row["method"] == method]
        if not own:
            continue
        ends = [at(row["curve"], 10**9) for row in own]
        tenth = [at(row["curve"], count) for row in own]
        there = [reached(row["curve"], mine[row["run_seed"]]) for row in own if row["run_seed"] in mine]
        middle = float(np.median(there)) if there else math.inf
        lines.append(
            [
                method,
                f"{np.median([row['trials'] for row in own]):.0f}",
                f"{np.median(tenth):.4f}",
                f"{np.median(ends):.4f}",
                f"{min(ends):.4f} to {max(ends):.4f}",
                f"{middle:.0f}" if math.isfinite(middle) else "never",
            ]
        )
    header = ["method", "trials", f"loss after {count}", "final loss", "min to max", "trials to ours"]
    caption = (
        f"Loss over the default's at the default's frame time; {len(mine)} seeds, medians; {settings['size']}, "
        f"{', '.join(settings['rooms'])}; {machine(runs[0])}."
    )
    return [Table(caption, header, lines), Plot(main.name, "Best so far: median and range.", figure(runs))]


def figure(runs: Sequence[Row]) -> Figure:
    """Best loss so far against trials."""
    fig = new_figure(7, 4.5)
    axes = fig.subplots()
    for method in METHODS:
        own = [row for row in runs if row["method"] == method]
        if not own:
            continue
        most = int(max(row["trials"] for row in own))
        trials = np.arange(1, most + 1)
        curves = np.array([[at(row["curve"], n) for n in trials] for row in own])
        middle = np.median(curves, axis=0)
        line = axes.plot(trials, middle, label=method)[0]
        axes.fill_between(trials, curves.min(axis=0), curves.max(axis=0), color=line.get_color(), alpha=0.15)
    axes.set(xscale="log", xlabel="trials", ylabel="best loss so far, over the default's", ylim=(None, 1.05))
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
