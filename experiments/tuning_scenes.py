"""Shared by the tuning experiments: the built-in room and a capture as benches, their frames, times and scores."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.blocks import Table
from experiments.command import RunConfig
from experiments.judging import summarise
from experiments.records import Results, Row, machine, of_kind
from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.frames import spread
from hyjax.metrics import plain_metrics
from hyjax.tuning.bench import Workbench, open_bench
from hyjax.tuning.calibration import compile_all, time_calls
from hyjax.tuning.cases import Case, scores
from hyjax.tuning.frame.report_text import described
from hyjax.tuning.request import split_frames
from hyjax.tuning.result import Milliseconds
from hyjax.tuning.settings import TuneScene, TuneSettings
from hyjax.util.errors import InputError

MOST_SECONDS = 120.0
"""For timing everything once more at the end."""

Pairs = Sequence[tuple[str, str]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComparisonConfig(RunConfig):
    """Options of an experiment that tunes, and compares schedules on frames held out."""

    size: tuple[int, int] = (512, 512)
    frames: int = 6
    """How many to tune on."""
    holdout: int = 6
    """How many to hold out, of the last quarter."""
    repeats: int = 100
    """Rounds of the timing at the end."""
    trials: int = 60
    """Of the search, for all budgets together."""
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Scene:
    """A capture with its meshes, and which frames are for what.

    Attributes:
        name: `room`, or the capture's.
        bench: meshes and lights.
        frames: indices to tune on, of the first three quarters.
        holdout: indices that nothing is chosen on, of the last quarter.
    """

    name: str
    bench: Workbench
    frames: list[int]
    holdout: list[int]

    def held_out(self) -> dict[str, Case]:
        """The frames held out, by name; without those that see no surface."""
        cases, blind = self.bench.cases(self.holdout, "held-out")
        return dict(zip([n for n in map(self.bench.name, self.holdout) if n not in blind], cases, strict=True))

    def record(self) -> dict[str, Any]:
        """A row of what was used."""
        return {
            "kind": "scene",
            "scene": self.name,
            "meshes": self.bench.description,
            "tuned_on": [self.bench.name(i) for i in self.frames],
            "held_out": [self.bench.name(i) for i in self.holdout],
        }


def open_scenes(kitchen: Path | None, size: tuple[int, int], tuning: int = 6, held_out: int = 6) -> list[Scene]:
    """The built-in room and, if given, a capture: rough against accurate mesh, under two coloured lights.

    Args:
        kitchen: the capture's folder.
        size: (height, width) to work at.
        tuning: how many frames to tune on, spread over the first three quarters.
        held_out: how many to hold out, spread over the last quarter; fewer if there are not as many.

    Raises:
        InputError: the capture cannot be used, or a number of frames below 1.
    """
    for name, value in (("tuning frames", tuning), ("held-out frames", held_out)):
        if value < 1:
            raise InputError(f"{name}: must be at least 1, got {value}")
    scenes = []
    for capture in (None,) if kitchen is None else (None, kitchen):
        bench = open_bench(TuneSettings(TuneScene(capture=capture, size=f"{size[1]}x{size[0]}")))
        count = len(bench.scene)
        first = count - max(1, count // 4)
        parts = (range(max(first, 1)), tuning), (range(first, count), held_out)
        frames, holdout = (",".join(map(str, spread(*part))) for part in parts)
        scenes.append(Scene(bench.scene.capture.name, bench, *split_frames(count, frames, holdout)))
    return scenes


def retime(runs: Sequence[tuple[Case, Sequence[Schedule]]], repeats: int) -> list[list[Milliseconds]]:
    """Fresh times of the diffusion stage, all scenes' schedules in turns; nothing remembered is used or changed.

    Args:
        runs: of each scene, a case to time on and the schedules.
        repeats: rounds, fewer (at least ten) if that would take more than `MOST_SECONDS`.
    """
    calls: dict[str, Any] = {}
    for i, (case, schedules) in enumerate(runs):
        compiled = compile_all(schedules, case.cascade_arguments, progress=True)
        calls |= {f"{i} {k}": call for k, call in enumerate(compiled)}
    times = time_calls(calls, repeats, most_seconds=MOST_SECONDS, progress=True)
    return [[times[f"{i} {k}"] for k in range(len(schedules))] for i, (_, schedules) in enumerate(runs)]


def add_scores(
    results: Results, scene: str, name: str, held: Mapping[str, Case], relight_filter: Callable[[Case], Any]
) -> None:
    """A row for each held-out frame under its filter."""
    for frame, case in held.items():
        found = scores([case], [relight_filter(case)])
        results.add(kind="score", scene=scene, name=name, frame=frame, **found)


def texts(schedule: Schedule) -> dict[str, str]:
    """A schedule's name, steps, κ, λ and α, for a row."""
    told = described(Configuration(schedule=schedule))
    parts = {"steps": "cascade", "kappa": "κ", "lam": "λ", "fidelity": "α"}
    return {"schedule": schedule.name} | {key: told.get(name, "-") for key, name in parts.items()}


def scenes_of(rows: Sequence[Row]) -> list[str]:
    """Names of the scenes with scores."""
    return list(dict.fromkeys(row["scene"] for row in of_kind(rows, "score")))


def scored(rows: Sequence[Row], scene: str) -> dict[str, list[Row]]:
    """The scores of a scene, frame by frame, by name of what was judged."""
    found: dict[str, list[Row]] = {}
    for row in of_kind(rows, "score"):
        if row["scene"] == scene:
            found.setdefault(row["name"], []).append(row)
    return found


def mean(each: Sequence[Row], key: str) -> float:
    """Mean of a score over frames."""
    return float(np.mean([row[key] for row in each]))


def score_headings() -> list[str]:
    """Headings of `mean_scores`."""
    return ["loss", *(metric.label for metric in plain_metrics().values())]


def mean_scores(each: Sequence[Row]) -> list[str]:
    """Mean loss and metrics over frames, as texts; a dash for a metric that older rows lack."""
    digits = {"loss": 5} | {name: metric.digits for name, metric in plain_metrics().items()}
    return [f"{mean(each, name):.{n}f}" if name in each[0] else "–" for name, n in digits.items()]


def comparison(
    rows: Sequence[Row],
    pairs: Callable[[str, list[str]], Sequence[tuple[str, str]]],
    time: Callable[[str, str], Any],
) -> Table:
    """Losses of schedules against others' on the same frames.

    Args:
        rows: with scores.
        pairs: of a scene and the names that have been judged in it, which are compared: (own, other).
        time: row of the measured time by scene and name, or None.
    """
    lines = []
    for scene in scenes_of(rows):
        judged = scored(rows, scene)
        for own, other in pairs(scene, list(judged)):
            if own in judged and other in judged:
                a, b = time(scene, own), time(scene, other)
                ratio = f"{100 * a['median'] / b['median']:.0f} %" if a and b else "–"
                lines.append([scene, own, other, ratio, *_difference(judged[own], judged[other])])
    header = ["scene", "schedule", "against", "time", "loss difference (95 %)", "% (95 %)", "better on"]
    caption = (
        "Loss against another's on the same held-out frames: mean difference and its 95 % interval. "
        "Frames of one walk are no independent rooms: the interval tells of frames like these."
    )
    return Table(caption, header, lines, names=3)


def _difference(own: Sequence[Row], other: Sequence[Row]) -> list[str]:
    """Mean difference of the losses with its interval, the same in percent, on how many frames it is below zero."""
    differences = [a["loss"] - b["loss"] for a, b in zip(own, other)]
    found, percent = summarise(differences), 100.0 / mean(other, "loss")
    assert found is not None
    cells = []
    for factor, digits in ((1.0, 5), (percent, 1)):
        ends = [] if found.half is None else [factor * (found.mean + sign * found.half) for sign in (-1, 1)]
        interval = f" ({' to '.join(f'{end:+.{digits}f}' for end in ends)})" if ends else ""
        cells.append(f"{factor * found.mean:+.{digits}f}{interval}")
    return [*cells, f"{sum(d < 0 for d in differences)} of {len(differences)}"]


def conditions(rows: Sequence[Row]) -> str:
    """Conditions of the figures, as the last words of a caption."""
    scenes = of_kind(rows, "scene")
    meshes = "; ".join(f"{row['scene']}: {row['meshes']}" for row in scenes)
    height, width = scenes[0]["settings"]["size"]
    return f"{height} x {width}, diffusion stage; {meshes}; {machine(scenes[0])}."
