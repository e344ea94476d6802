"""Numbers of a configuration: by the gradient of the loss, and by Optuna's samplers.

    pip install -e ".[tune]"
    python -m experiments.number_search [--trials 60] [--seeds 5] [--out results/number_search] [--resume]

κ, λ and α of the default's cascades, the exponent of the photo's light and the gain of bounces: six numbers, in the
ranges of `hyjax tune`. Gradients (`hyjax.tuning.refinement`) see the loss and its slope in each iteration; TPE
(multivariate, in groups), NSGA-II and random search see the loss alone and begin at the default as well. All judge
the same pictures of one room. Seconds are of the processor. What each ends with is judged on rooms that nothing was
chosen on.

`--weights` gives the gradients other weights of brightness (`hyjax.tuning.loss`): what the loss finds that compares
pictures under fitted gains alone, and with a term without gains. Loss, SSIM and PSNR are then of the rooms.
`--presets` judges presets by today's loss, as they come and with their numbers moved on the room; with `--seeds 0
--weights` alone.

Takes about fifteen minutes on two cores, and two minutes more for each room that is not in the cache.

Expect: after the gradients' thirteen evaluations a loss that fifty trials of TPE or NSGA-II come near to; on rooms
that no setting was chosen with, no difference worth a word.
"""

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, machine, of_kind
from hyjax.configuration import Configuration
from hyjax.data.truth_room import load_truth_room
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.tuning.evaluation import FrameCase, Judge, mean_scores
from hyjax.tuning.loss import PictureLoss
from hyjax.tuning.refinement import numbers_of, refine_numbers, settled
from hyjax.tuning.scene import TuningScene, spread_cases
from hyjax.tuning.settings import ROOM_PHOTOS, SETUPS
from hyjax.tuning.space import Space
from hyjax.util.errors import InputError
from hyjax.util.sizes import parse_size

GRADIENTS = "gradients"
SAMPLERS = ("TPE", "NSGA-II", "random")
POPULATION = 12
"""Of NSGA-II: with the usual 50, few trials would be its first, random generation."""
CASES = 6
METRICS = ("relative", "ssim", "psnr", "psnr_raw")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    room: str = "builtin-0"
    """Room of known truth to search on."""
    report: tuple[str, ...] = ("builtin-3", "random-5-6-day")
    """Rooms to report on."""
    size: str = "160x120"
    """Width x height of the pictures."""
    quality: float = 1.0
    """Of the rooms' light and textures."""
    trials: int = 60
    """Of each sampler."""
    seeds: int = 5
    weights: tuple[float, ...] = (0.0, 0.25, 0.5, 1.0)
    """Weights of brightness that the gradients are given."""
    presets: tuple[str, ...] = ()
    """Presets to judge as they come, and with numbers by gradients."""
    resume: bool = False


@experiment("Numbers by gradients and by samplers")
def main(config: Config, start: Start) -> None:
    if config.room in config.report:
        raise InputError("report: the room is searched on as well; leave it out")
    results = start()
    scenes = [opened(config, name) for name in (config.room, *config.report)]
    frames = spread_cases([[1, 6, 10]], SETUPS, 0)
    cases = [[(place, lights, index) for _, lights, index in frames] for place in range(len(scenes))]
    rooms = (config.room, *config.report)

    def held_out(configuration: Configuration) -> list[dict[str, Any]]:
        judge = Judge(scenes, PictureLoss())
        return [
            {"room": room, "scores": compared(judge, configuration, own)}
            for room, own in zip(rooms, cases, strict=True)
        ]

    for weight in config.weights:
        if any(row["weight"] == weight for row in of_kind(results.rows, "weight")):
            continue
        judge = Judge(scenes, PictureLoss(brightness=weight))
        found = refine_numbers(Configuration(), judge, cases[0][:CASES])
        for row in held_out(found):
            results.add(kind="weight", weight=weight, **row, numbers=as_floats(found))
    judge = Judge(scenes, PictureLoss())
    for preset in config.presets:
        if any(row["preset"] == preset for row in of_kind(results.rows, "preset")):
            continue
        usual = Configuration.preset(preset)
        refined = refine_numbers(usual, judge, cases[0][:CASES], levels=True)
        for name, configuration in (("as it comes", usual), ("numbers by gradients", refined)):
            for row in held_out(configuration):
                results.add(kind="preset", preset=preset, numbers=name, **row, text=configuration.to_json())
    methods: list[tuple[str, int]] = [(GRADIENTS, 0)] if config.seeds else []
    methods += [(method, seed) for seed in range(config.seeds) for method in SAMPLERS]
    done = {(row["method"], row["sampler_seed"]) for row in of_kind(results.rows, "search")}
    for method, seed in methods:
        if (method, seed) in done:
            continue
        search = by_gradients if method == GRADIENTS else sampled(method, seed, config.trials)
        found, losses, seconds = search(judge, cases[0][:CASES])
        told = {"losses": losses, "seconds": seconds, "numbers": as_floats(found)}
        results.add(kind="search", method=method, sampler_seed=seed, **told, rooms=held_out(found))


def opened(config: Config, name: str) -> TuningScene:
    """A room of known truth."""
    height, width = parse_size(config.size) or (0, 0)
    capture = load_truth_room(name, ROOM_PHOTOS, width, height, quality=config.quality)
    return TuningScene(name, Scene.open(SceneSettings(), capture=capture))


Search = Callable[[Judge, Sequence[FrameCase]], tuple[Configuration, list[float], list[float]]]
"""Configuration that is found, loss of each evaluation over the default's, processor seconds of each."""


def by_gradients(judge: Judge, cases: Sequence[FrameCase]) -> tuple[Configuration, list[float], list[float]]:
    """Search by gradients."""
    losses, clock = list[float](), [processor_seconds()]

    def report(_: int, loss: float) -> None:
        losses.append(loss)
        clock.append(processor_seconds())

    return refine_numbers(Configuration(), judge, cases, report=report), losses, np.diff(clock).tolist()


def sampled(method: str, seed: int, trials: int) -> Search:
    """Search by a sampler of Optuna."""

    def search(judge: Judge, cases: Sequence[FrameCase]) -> tuple[Configuration, list[float], list[float]]:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        base, usual = Configuration(), as_floats(Configuration())
        before = [row["loss"] for row in judge.scores(base, cases)]
        ranges = {name: Space.of(truth=True).named[name].values for name in usual}
        clock = [processor_seconds()]

        def objective(trial: Any) -> float:
            numbers = {n: trial.suggest_float(n, low, high, log=True) for n, (low, high) in ranges.items()}
            rows = judge.scores(with_floats(numbers), cases)
            clock.append(processor_seconds())
            return float(np.exp(np.mean(np.log([row["loss"] / b for row, b in zip(rows, before, strict=True)]))))

        study = optuna.create_study(sampler=sampler_named(method, seed))
        study.enqueue_trial({n: float(np.clip(x, *ranges[n])) for n, x in usual.items()})
        study.optimize(objective, n_trials=trials)
        losses = [trial.value for trial in study.trials]
        return with_floats(study.best_params), losses, np.diff(clock).tolist()

    return search


def sampler_named(method: str, seed: int, constraints: Callable[[Any], Sequence[float]] | None = None) -> Any:
    """A sampler of Optuna, of trials that fit where the constraints are at most 0."""
    from optuna.samplers import NSGAIISampler, RandomSampler, TPESampler

    if method == "TPE":
        return TPESampler(seed=seed, multivariate=True, group=True, constraints_func=constraints)
    if method == "NSGA-II":
        return NSGAIISampler(seed=seed, population_size=POPULATION, constraints_func=constraints)
    return RandomSampler(seed=seed)


def as_floats(configuration: Configuration) -> dict[str, float]:
    """Numbers of a configuration, one for all levels."""
    return {name: float(value) for name, value in numbers_of(configuration, levels=False).items()}


def with_floats(numbers: Mapping[str, float]) -> Configuration:
    """The default with other numbers."""
    return settled(Configuration(), {name: jnp.asarray(value) for name, value in numbers.items()})


def compared(judge: Judge, configuration: Configuration, cases: Sequence[FrameCase]) -> dict[str, list[float]]:
    """Scores of the default and of a configuration; `relative` is the mean of losses over the default's."""
    base, own = (judge.scores(each, cases) for each in (Configuration(), configuration))
    ratio = float(np.exp(np.mean([np.log(b["loss"] / a["loss"]) for a, b in zip(base, own, strict=True)])))
    means = mean_scores(base), mean_scores(own)
    return {"relative": [1.0, ratio]} | {name: [mean[name] for mean in means] for name in METRICS[1:]}


def processor_seconds() -> float:
    """Processor time of this process and of its children."""
    return sum(os.times()[:4])


def best_so_far(row: Row) -> list[float]:
    """The least loss after each evaluation."""
    return np.minimum.accumulate(row["losses"]).tolist()


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    made: list[Block] = []
    if presets := of_kind(rows, "preset"):
        made.append(preset_table(presets))
    searches = of_kind(rows, "search")
    if not searches:
        return made or ["There is no search yet."]
    first = searches[0]
    made.insert(0, search_table(searches))
    if weights := of_kind(rows, "weight"):
        made.append(weight_table(weights))
    caption = f"Least loss so far on {first['settings']['room']}: median and range over seeds; {machine(first)}."
    return [*made, Plot(main.name, caption, figure(searches))]


def search_table(searches: Sequence[Row]) -> Table:
    """Least loss of each method, and its evaluations until it reaches the gradients' loss."""
    level = best_so_far(searches[0])[-1]
    held = [room["room"] for room in searches[0]["rooms"]][1:]
    lines = []
    for method in (GRADIENTS, *SAMPLERS):
        own = [row for row in searches if row["method"] == method]
        if not own:
            continue
        reached = [next((n for n, x in enumerate(best_so_far(row), 1) if x <= level), None) for row in own]
        ends = [best_so_far(row)[-1] for row in own]
        steady = [float(np.median(row["seconds"])) for row in own]
        counts = [str(len(own)), str(len(own[0]["losses"]))]
        cells = [*counts, f"{np.median(steady):.2f}", spread_text(ends)]
        cells.append(", ".join("never" if n is None else str(n) for n in reached))
        for room in held:
            found = [next(r["scores"]["relative"][1] for r in row["rooms"] if r["room"] == room) for row in own]
            cells.append(spread_text(found))
        lines.append([method, *cells])
    settings = searches[0]["settings"]
    caption = (
        f"Six numbers, searched on {CASES} pictures of {settings['room']} at {settings['size']}, quality "
        f"{settings['quality']:g}; change of the loss, median (range over seeds); seconds of the processor for an "
        "evaluation, median."
    )
    header = ["method", "seeds", "evaluations", "s each", settings["room"], "trials to the gradients' loss", *held]
    return Table(caption, header, lines)


def spread_text(ratios: Sequence[float]) -> str:
    """Median of changes in per cent, and their range."""
    changes = [100 * (ratio - 1) for ratio in ratios]
    if len(changes) == 1:
        return f"{changes[0]:+.1f} %"
    return f"{np.median(changes):+.1f} % ({min(changes):+.1f} to {max(changes):+.1f})"


def weight_table(weights: Sequence[Row]) -> Table:
    """Scores of what the gradients find with each weight of brightness."""
    lines = [[f"{row['weight']:g}", row["room"], *changes(row["scores"])] for row in weights]
    settings = weights[0]["settings"]
    caption = (
        f"Numbers by gradients on {settings['room']}, with weights of the term without gains: changes from the "
        "default. The loss is that of `hyjax tune`."
    )
    return Table(caption, ["weight", "room", "loss", "SSIM", "PSNR fitted, dB", "PSNR raw, dB"], lines, names=2)


def preset_table(presets: Sequence[Row]) -> Table:
    """Scores of presets, as they come and with numbers by gradients."""
    lines = [[row["preset"], row["numbers"], row["room"], *changes(row["scores"])] for row in presets]
    settings = presets[0]["settings"]
    caption = (
        f"Presets by today's loss at {settings['size']}, quality {settings['quality']:g}: changes from the "
        f"default. Numbers by gradients are of {settings['room']}, each level's own."
    )
    header = ["preset", "numbers", "room", "loss", "SSIM", "PSNR fitted, dB", "PSNR raw, dB"]
    return Table(caption, header, lines, names=3)


def changes(scores: Mapping[str, Sequence[float]]) -> list[str]:
    """Changes of scores from the default's."""
    cells = [f"{100 * (scores['relative'][1] - 1):+.1f} %", f"{scores['ssim'][1] - scores['ssim'][0]:+.4f}"]
    return cells + [f"{scores[name][1] - scores[name][0]:+.2f}" for name in ("psnr", "psnr_raw")]


def figure(searches: Sequence[Row]) -> Figure:
    """Least loss after each evaluation, a line and a band for each method."""
    fig = new_figure(7.5, 4.2)
    axes = fig.subplots()
    for number, method in enumerate((GRADIENTS, *SAMPLERS)):
        own = [best_so_far(row) for row in searches if row["method"] == method]
        if not own:
            continue
        values, steps = 100 * (np.array(own) - 1), np.arange(1, len(own[0]) + 1)
        axes.plot(steps, np.median(values, axis=0), color=f"C{number}", label=method)
        if len(own) > 1:
            axes.fill_between(steps, values.min(axis=0), values.max(axis=0), color=f"C{number}", alpha=0.15)
    axes.axhline(0.0, color="0.7", linewidth=0.8)
    axes.set(xlabel="evaluations", ylabel="change of the loss from the default's, %", xlim=(1, None))
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
