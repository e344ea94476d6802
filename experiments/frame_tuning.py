"""Configurations of the whole frame: the front of quality against time on rooms that no setting was chosen with.

    pip install -e ".[tune]"
    python -m experiments.frame_tuning [--trials 48] [--out results/frame_tuning] [--resume]

Searches all choices of a frame (`hyjax tune`) on four rooms of known truth and reports on four others. The front,
the presets as they come with hyjax and the paper's form, as it is and tuned (`--paper-trials`), are timed in turns
with the default configuration in one run. *Loss* is relative to the default's on the same frames.

`--presets` writes what comes out as the presets, by loss on the tuning rooms, unless the present ones do better:
`quality` is the best within half again the default's time, `balanced` within 0.55 of it, and `fast` within 0.45
of it, each of those that are left. They are timed and judged once more, in turns, as they come with hyjax.

Takes about forty minutes on two cores, and two minutes more for each room that is not in the cache.

Expect: at the default's time a few percent less loss than the default on rooms that no setting was chosen with,
most of it by the numbers (κ, α, the exponent of the photo's light); its quality in a little more than half of its
time.
"""

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Results, Row, machine, of_kind
from hyjax.configuration import DEFAULT, FOLDER, PRESETS, Configuration
from hyjax.scene.settings import parse_size
from hyjax.synthetic.truth import DEVELOPMENT_ROOMS, TEST_ROOMS
from hyjax.tuning.bench import open_frame_bench
from hyjax.tuning.proof import prove
from hyjax.tuning.result import Candidate
from hyjax.tuning.settings import SETUPS, FrameOptions, TuneScene, TuneSettings
from hyjax.tuning.space import Choices, Space, structure
from hyjax.tuning.stage import FrameStage
from hyjax.tuning.time_model import SHORTEST_RATIO, TimeModel
from hyjax.tuning.trial import Trial
from hyjax.tuning.tune import tune
from hyjax.util.errors import InputError
from hyjax.util.files import write_text

UNLIMITED_MS = 1e4
MOST_TIMES = {"quality": 1.5, "balanced": 0.55, "fast": 0.47}
"""Largest time of each preset, over the default's."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    rooms: tuple[str, ...] = DEVELOPMENT_ROOMS
    """Rooms of known truth to tune on."""
    report: tuple[str, ...] = TEST_ROOMS
    """Rooms to report on."""
    size: str = "512x384"
    """Width x height of the pictures."""
    frames: int = 3
    """Of each room under each set-up."""
    trials: int = 48
    paper_trials: bool = True
    """Also tune the paper's form."""
    choices: tuple[str, ...] = ("light_edges=true",)
    """Choices that are not searched, see `hyjax tune`. Without light edges real patches are left less even
    (`experiments.patches`), of which rooms that are generated tell little."""
    presets: bool = False
    """Write the presets of the package."""
    seed: int = 0
    resume: bool = False


@experiment("Configurations of the whole frame", "candidate")
def main(config: Config, start: Start) -> None:
    parse_size(config.size)
    if set(config.rooms) & set(config.report):
        raise InputError("report: a room is tuned on as well; leave it out of one")
    results = start()
    done = of_kind(results.rows, "candidate")
    if not done:
        tuned = tune(
            settings=settings_of(config, config.rooms, config.report, config.trials, results.out / "search")
        )
        for candidate in tuned.candidates:
            results.add(kind="candidate", front=candidate in tuned.front, **described(candidate))
        for effect in tuned.effects:
            results.add(kind="effect", **dataclasses.asdict(effect))
        told = {k: v for k, v in tuned.record.items() if k in SEARCH}
        results.add(kind="search", **told, left_out=time_errors(tuned.trials))
        shutil.copy(results.out / "search" / "contact_sheet.png", results.out / "contact_sheet.png")
    if config.presets:
        write_presets(of_kind(results.rows, "candidate"), FrameOptions(choices=config.choices).held)
    if not of_kind(results.rows, "preset"):
        add_presets(results, config)


SEARCH = ("trials", "cases", "held-out cases", "timed under", "prediction errors", "seconds")


def errors_left_out(space: Space, trials: Sequence[Choices], times: Sequence[float]) -> list[float]:
    """Relative errors of times that are predicted from all other trials."""
    found = []
    for number, (choices, time) in enumerate(zip(trials, times, strict=True)):
        others = [k for k in range(len(trials)) if k != number]
        model = TimeModel.fit(space, [trials[k] for k in others], [times[k] for k in others])
        found.append(abs(float(model([choices])[0]) / max(time, SHORTEST_RATIO) - 1.0))
    return found


def time_errors(trials: Sequence[Trial]) -> list[float]:
    """Relative errors of the time model for each trial of other discrete choices, left out in turn."""
    space, found = Space.of(truth=True), dict[str, tuple[Choices, float]]()
    for trial in trials:
        if trial.time is not None:
            choices = space.complete(trial.choices)  # with the sampling that runs
            found.setdefault(structure(choices, space), (choices, trial.time))
    return errors_left_out(space, *zip(*found.values(), strict=True)) if len(found) > 1 else []


def settings_of(
    config: Config, rooms: Sequence[str], report: Sequence[str], trials: int, out: Path
) -> TuneSettings:
    """Settings of a search."""
    options = FrameOptions(
        rooms=tuple(rooms),
        holdout_rooms=tuple(report),
        room_size=config.size,
        room_frames=config.frames,
        trials=trials,
        choices=config.choices,
        paper_form=config.paper_trials and bool(report),
    )
    scene = TuneScene(seed=config.seed)
    return TuneSettings(scene, frame=options, budget_ms=(UNLIMITED_MS,), out=out, resume=out.exists())


def described(candidate: Candidate) -> dict[str, Any]:
    """A candidate as JSON's types."""
    return candidate.row() | {"configuration": candidate.configuration.to_json()}


def chosen_presets(candidates: Sequence[Row], held: Mapping[str, Any]) -> dict[str, Row]:
    """Preset → candidate, of those with these values, by loss on the tuning rooms and time alone."""
    forms = [row for row in candidates if row["form"] == "hyjax" and row["name"] != DEFAULT]
    values = [Configuration.from_json(row["configuration"]).values() for row in forms]
    left = [row for row, own in zip(forms, values, strict=True) if held.items() <= own.items()]
    chosen = dict[str, Row]()
    for name, most in MOST_TIMES.items():
        if quick := [row for row in left if row["median_ms"] <= most * row["default_ms"]]:
            chosen[name] = min(quick, key=lambda row: row["tuning"]["relative"])
            left.remove(chosen[name])
    return chosen


def write_presets(candidates: Sequence[Row], held: Mapping[str, Any]) -> None:
    """Write the presets of the package, of candidates with these values of choices."""
    for name, row in chosen_presets(candidates, held).items():
        configuration = Configuration.from_json(row["configuration"])
        own = dataclasses.replace(configuration.schedule, name=name)
        shadow = dataclasses.replace(configuration.shadow_schedule, name=f"{name}-shadow")
        chosen = dataclasses.replace(configuration, name=name, schedule=own, shadow_schedule=shadow, measured=None)
        write_text(FOLDER / f"{name}.json", chosen.to_json() + "\n")


def add_presets(results: Results, config: Config) -> None:
    """Time and judge the default, the presets and the paper's form, in turns."""
    bench = open_frame_bench(
        settings_of(config, config.rooms, config.report, config.trials, results.out / "search")
    )
    configurations = [Configuration(), *map(Configuration.preset, PRESETS), Configuration.paper()]
    for row in of_kind(results.rows, "candidate"):
        if row["name"] == "paper-tuned":
            configurations.append(Configuration.from_json(row["configuration"]))
    for candidate in prove(configurations, FrameStage(bench, TuneSettings()), progress=True):
        results.add(kind="preset", front=False, **described(candidate))


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    candidates = of_kind(rows, "candidate")
    settings = candidates[0]["settings"]
    caption = (
        f"Whole frames of {settings['size']}, one at a time, median and p95 in turns with the default; tuned on "
        f"{', '.join(settings['rooms'])}, reported on {', '.join(settings['report'])}, {len(SETUPS)} set-ups each; "
        f"{machine(candidates[0])}."
    )
    made: list[Block] = []
    if presets := of_kind(rows, "preset"):
        made.append(table(f"Presets. {caption}", presets))
    made.append(table(f"What the search found. {caption}", candidates))
    for search in of_kind(rows, "search"):
        errors = np.array(search["prediction errors"] or [0.0])
        made.append(
            f"{search['trials']} trials in {search['seconds']:.0f} s; times of what the surrogate proposed were "
            f"foretold to {100 * np.median(errors):.1f} % (median), {100 * errors.max():.1f} % (worst of "
            f"{len(errors)})."
        )
        if left_out := search.get("left_out"):
            made.append(
                f"Left out one at a time, the times of {len(left_out)} trials are predicted to "
                f"{100 * np.median(left_out):.1f} % (median), {100 * np.max(left_out):.1f} % (worst)."
            )
    if effects := of_kind(rows, "effect"):
        shown = [
            [e["parameter"], f"{e['base']} → {e['value']}", percent(e["loss"]), percent(e["time"])]
            for e in sorted(effects, key=lambda e: e["loss"])
        ]
        made.append(Table("Choices by themselves.", ["choice", "change", "loss", "time"], shown, names=2))
    drawn = figure(candidates, of_kind(rows, "preset"))
    made.append(Plot(main.name, "Loss on held-out rooms against time; both axes logarithmic.", drawn))
    return made


SHOWN = {"psnr_raw": 2, "psnr": 2, "ssim": 4}
"""Scores on held-out rooms that the tables show, and their digits."""


def table(caption: str, rows: Sequence[Row]) -> Table:
    """Configurations with times and losses, by time."""
    lines = []
    for row in sorted(rows, key=lambda r: r["median_ms"]):
        held = row["held_out"] or {}
        lines.append(
            [
                row["name"],
                f"{row['median_ms']:.1f}",
                f"{row['p95_ms']:.1f}",
                f"{row['median_ms'] / row['default_ms']:.2f}",
                percent(row["tuning"]["relative"]),
                percent(held.get("relative")),
                *(f"{held[n]:.{digits}f}" if n in held else "–" for n, digits in SHOWN.items()),
            ]
        )
    header = ["configuration", "ms", "p95", "of default", "loss, tuning", "loss, held out"]
    header += ["PSNR raw", "fitted", "SSIM"]
    return Table(caption, header, lines)


def percent(relative: float | None) -> str:
    """Change in percent."""
    return "–" if relative is None else f"{100 * (relative - 1):+.1f} %"


def figure(candidates: Sequence[Row], presets: Sequence[Row]) -> Figure:
    """Held-out loss against time."""
    fig = new_figure(7.5, 5)
    axes = fig.subplots()
    front = sorted((row for row in candidates if row["front"] and row["held_out"]), key=lambda r: r["median_ms"])
    line = np.array([[row["median_ms"], row["held_out"]["relative"]] for row in front]).reshape(-1, 2)
    axes.plot(*line.T, "o-", color="C0", label="front of the search")
    for row in presets or candidates:
        if not row["held_out"]:
            continue
        x, y, paper = row["median_ms"], row["held_out"]["relative"], row["form"] == "paper"
        axes.plot(x, y, "s" if paper else "D", color="C3" if paper else "C1")
        beneath = row["name"] in ("paper-tuned", "quality")
        side = {"xytext": (-8 if paper else 8, -13 if beneath else 5), "ha": "right" if paper else "left"}
        axes.annotate(row["name"], (x, y), textcoords="offset points", fontsize=9, **side)
    axes.axhline(1.0, color="0.7", linewidth=0.8)
    axes.set(
        xscale="log", yscale="log", xlabel="ms a frame, median", ylabel="loss on held-out rooms, of the default's"
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.tick_params(which="minor", labelsize=8)
    axes.legend(loc="upper left")
    return fig


if __name__ == "__main__":
    run(main)
