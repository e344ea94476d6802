"""All choices of a frame by the tuner's search and by Optuna's samplers, at the default's time.

    pip install -e ".[tune]"
    python -m experiments.space_race [--trials 40] [--seeds 5] [--out results/space_race] [--resume]

The search of `hyjax tune` without its presets, TPE (multivariate, in groups, with the time as a constraint),
NSGA-II (likewise) and random search have the same space, the same pictures of one room, and begin at the default.
A trial counts where it takes no longer than the default, in turns with it; one of ours may be a descent by
gradients, which takes longer: both trials and processor seconds, programs' compiling in them, are told. What each
ends with is judged on rooms that no setting was chosen with.

Rows are of one seed and method each, and seeds come one after the other: a run that is broken off has whole seeds,
and `--resume` adds the others.

Takes some four minutes on two cores for each search of forty trials, twenty of them by default.

Expect: ours lower from the second trial on than TPE ends: the first descent by gradients brings most of it. NSGA-II
and random search find little in so many trials.
"""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.number_search import CASES, compared, opened, processor_seconds, sampler_named, spread_text
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind
from hyjax.tuning.clock import FrameClock, slowest_setup
from hyjax.tuning.evaluation import Judge
from hyjax.tuning.evaluator import StudyEvaluator
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.scene import spread_cases
from hyjax.tuning.search import init, search
from hyjax.tuning.settings import SETUPS
from hyjax.tuning.space import Parameter, Space
from hyjax.tuning.study import Study
from hyjax.tuning.trial import Trial
from hyjax.util.errors import InputError

OURS = "hyjax tune"
METHODS = (OURS, "TPE", "NSGA-II", "random")
BUDGET = 1.0
"""Longest time over the default's."""
POINTS = (4, 10, 20, 40, 60)
"""Trials after which the table tells the least loss."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    room: str = "builtin-0"
    """Room of known truth to search on."""
    report: tuple[str, ...] = ("builtin-3",)
    """Rooms to report on."""
    size: str = "160x120"
    """Width x height of the pictures."""
    quality: float = 0.3
    """Of the rooms' light and textures."""
    trials: int = 40
    """Of each method."""
    seeds: int = 5
    resume: bool = False


@experiment("All choices by the tuner's search and by samplers", "race")
def main(config: Config, start: Start) -> None:
    if config.room in config.report:
        raise InputError("report: the room is searched on as well; leave it out")
    results = start()
    rooms = (config.room, *config.report)
    scenes = [opened(config, name) for name in rooms]
    frames = spread_cases([[1, 6, 10]], SETUPS, 0)
    cases = [[(place, lights, index) for _, lights, index in frames] for place in range(len(scenes))]
    space, judge = Space.of(truth=True), Judge(scenes, PictureLoss())
    clock = FrameClock(scenes[0], slowest_setup(scenes[0], SETUPS))
    done = {(row["method"], row["search_seed"]) for row in of_kind(results.rows, "race")}
    for seed in range(config.seeds):
        for method in METHODS:
            if (method, seed) in done:
                continue
            jax.clear_caches()  # what another method compiled
            evaluator = StudyEvaluator(space, judge, cases[0][:CASES], clock, Study(None, "race", {}), seed=seed)
            run_search = ours if method == OURS else sampled
            trials, seconds = run_search(method, seed, config.trials, space, evaluator)
            best = min((t for t in trials if fits(t)), key=lambda t: t.loss)
            found = space.configuration(best.choices)
            told = {"losses": [t.loss for t in trials], "times": [t.time for t in trials], "seconds": seconds}
            pairs = zip(rooms, cases, strict=True)
            scores = [{"room": room, "scores": compared(judge, found, own)} for room, own in pairs]
            results.add(kind="race", method=method, search_seed=seed, **told, rooms=scores, choices=best.choices)


Judged = Callable[[Trial], Trial]


def fits(trial: Trial) -> bool:
    """Whether a trial takes no longer than the default."""
    return trial.time is not None and trial.time <= BUDGET


def ours(_: str, seed: int, trials: int, space: Space, judged: Judged) -> tuple[list[Trial], list[float]]:
    """Search of `hyjax tune`: its trials, and the processor seconds of each."""
    clock, found = [processor_seconds()], list[Trial]()

    def report(_: Any, trial: Trial) -> None:
        found.append(trial)
        clock.append(processor_seconds())

    search(init(space, [CASES], trials, relaxes=1, seed=seed), judged, [BUDGET], report=report)
    return found, np.diff(clock).tolist()


def sampled(method: str, seed: int, trials: int, space: Space, judged: Judged) -> tuple[list[Trial], list[float]]:
    """Search by a sampler of Optuna, likewise."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    clock, found = [processor_seconds()], list[Trial]()

    def objective(asked: Any) -> float:
        choices = space.complete({p.name: suggested(asked, p) for p in space.parameters})
        trial = judged(Trial(choices, method, cases=CASES))
        found.append(trial)
        clock.append(processor_seconds())
        asked.set_user_attr("over", (trial.time or np.inf) - BUDGET)
        return trial.loss

    study = optuna.create_study(sampler=sampler_named(method, seed, lambda asked: (asked.user_attrs["over"],)))
    study.enqueue_trial({p.name: as_suggested(p) for p in space.parameters})
    study.optimize(objective, n_trials=trials)
    return found, np.diff(clock).tolist()


def suggested(asked: Any, parameter: Parameter) -> Any:
    """Value of a parameter that a sampler suggests: of ordered values their place."""
    if parameter.continuous:
        return asked.suggest_float(parameter.name, *parameter.values, log=parameter.log)
    if parameter.factor:
        return asked.suggest_int(parameter.name, 0, max(parameter.values))
    if parameter.ordered:
        return parameter.values[asked.suggest_int(parameter.name, 0, len(parameter.values) - 1)]
    return asked.suggest_categorical(parameter.name, parameter.values)


def as_suggested(parameter: Parameter) -> Any:
    """The default's value as a sampler has it."""
    placed = parameter.ordered and not parameter.factor
    return parameter.values.index(parameter.default) if placed else parameter.default


def best_so_far(row: Row) -> list[float]:
    """The least loss within the budget after each trial; one for each that was tried twice, too."""
    losses = [x if time is not None and time <= BUDGET else np.inf for x, time in zip(row["losses"], row["times"])]
    return np.minimum.accumulate(losses).tolist()


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table and figure from the rows."""
    races = of_kind(rows, "race")
    settings = races[0]["settings"]
    held = [room["room"] for room in races[0]["rooms"]][1:]
    by_seed = {row["search_seed"]: best_so_far(row) for row in races if row["method"] == OURS}
    points = [n for n in POINTS if n <= max(len(row["losses"]) for row in races)]
    lines = []
    for method in METHODS:
        own = [row for row in races if row["method"] == method]
        if not own:
            continue
        curves = [best_so_far(row) for row in own]
        cells = [str(len(own)), f"{np.median([sum(row['seconds']) for row in own]):.0f}"]
        cells += [spread_text([curve[min(n, len(curve)) - 1] for curve in curves]) for n in points]
        cells += [reached_text(own, curves, by_seed)]
        for room in held:
            cells.append(spread_text([scores_of(row, room)["relative"][1] for row in own]))
        lines.append([method, *cells])
    caption = (
        f"All choices, searched on {CASES} pictures of {settings['room']} at {settings['size']}, quality "
        f"{settings['quality']:g}, within the default's time; change of the loss, median (range over seeds), after "
        "so many trials; processor seconds of a search; trials to what ours of the seed has after a tenth of all."
    )
    header = ["method", "seeds", "s", *(f"{n} trials" for n in points), "trials to our tenth", *held]
    note = f"Least loss so far on {settings['room']}: median and range over seeds; {machine(races[0])}."
    return [Table(caption, header, lines), Plot(main.name, note, figure(races))]


def scores_of(row: Row, room: str) -> Mapping[str, Any]:
    """Scores of a race's best on a room."""
    found: Mapping[str, Any] = next(each["scores"] for each in row["rooms"] if each["room"] == room)
    return found


def reached_text(own: Sequence[Row], curves: Sequence[list[float]], by_seed: Mapping[int, list[float]]) -> str:
    """Trials of each seed until the loss that our search of that seed has after a tenth of its trials."""
    counts = []
    for row, curve in zip(own, curves, strict=True):
        if (first := by_seed.get(row["search_seed"])) is not None:
            level = first[max(1, len(first) // 10) - 1]
            counts.append(next((str(n) for n, x in enumerate(curve, 1) if x <= level), "never"))
    return ", ".join(counts)


def figure(races: Sequence[Row]) -> Figure:
    """Least loss after each trial, and after so many processor seconds, a line and a band for each method."""
    fig = new_figure(9.0, 4.2)
    by_trials, by_seconds = fig.subplots(1, 2, sharey=True)
    for number, method in enumerate(METHODS):
        own = [row for row in races if row["method"] == method]
        if not own:
            continue
        most = min(len(row["losses"]) for row in own)
        values = 100 * (np.array([best_so_far(row)[:most] for row in own]) - 1)
        steps = np.arange(1, most + 1)
        by_trials.plot(steps, np.median(values, axis=0), color=f"C{number}", label=method)
        if len(own) > 1:
            by_trials.fill_between(steps, values.min(axis=0), values.max(axis=0), color=f"C{number}", alpha=0.15)
        for row in own:
            changes = 100 * (np.array(best_so_far(row)) - 1)
            by_seconds.step(np.cumsum(row["seconds"]), changes, where="post", color=f"C{number}", linewidth=1)
    for axes, label in ((by_trials, "trials"), (by_seconds, "processor seconds")):
        axes.axhline(0.0, color="0.7", linewidth=0.8)
        axes.set(xlabel=label, xlim=(0, None))
    by_trials.set_ylabel("change of the loss from the default's, %")
    by_trials.legend()
    return fig


if __name__ == "__main__":
    run(main)
