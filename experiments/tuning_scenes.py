"""What the tuning experiments share: the built-in room and a capture as benches, their frames, times and scores."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from hyjax.data.frames import spread
from hyjax.environment import environment, peak_memory_mib
from hyjax.errors import InputError
from hyjax.files import whole, write_text
from hyjax.schedule import Schedule
from hyjax.tuning.bench import Workbench, open_bench
from hyjax.tuning.calibration import compile_all, time_calls
from hyjax.tuning.cases import Case, scores
from hyjax.tuning.request import split_frames
from hyjax.tuning.result import Milliseconds, Scores
from hyjax.tuning.search import Effort

MOST_SECONDS = 120.0
"""For timing everything once more at the end."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComparisonConfig:
    """Options of an experiment that tunes, and compares schedules on frames held out."""

    size: tuple[int, int] = (512, 512)
    frames: int = 6
    """How many to tune on."""
    holdout: int = 6
    """How many to hold out, of the last quarter."""
    repeats: int = 100
    """Rounds of the timing at the end."""
    effort: Effort = dataclasses.field(default_factory=Effort)
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

    def record(self) -> dict[str, Any]:
        """What was used, as JSON's types."""
        return {
            "scene": self.name,
            "meshes": self.bench.description,
            "tuned on": self.frames,
            "held out": self.holdout,
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
        bench = open_bench(capture, size=size)
        count = len(bench.capture)
        first = count - max(1, count // 4)
        parts = (range(max(first, 1)), tuning), (range(first, count), held_out)
        frames, holdout = (",".join(map(str, spread(*part))) for part in parts)
        scenes.append(Scene(bench.capture.name, bench, *split_frames(count, frames, holdout)))
    return scenes


def retime(runs: Sequence[tuple[Case, Sequence[Schedule]]], repeats: int) -> list[list[Milliseconds]]:
    """Fresh times of the diffusion stage, all scenes' schedules in turns; nothing remembered is used or changed.

    Args:
        runs: of each scene, a case to time on and the schedules.
        repeats: rounds, fewer (at least ten) if that would take more than `MOST_SECONDS`.
    """
    calls = {}
    for i, (case, schedules) in enumerate(runs):
        compiled = compile_all(schedules, (case.shading, case.known, case.guide), progress=True)
        calls |= {f"{i} {k}": call for k, call in enumerate(compiled)}
    times = time_calls(calls, repeats, most_seconds=MOST_SECONDS, progress=True)
    return [[times[f"{i} {k}"] for k in range(len(schedules))] for i, (_, schedules) in enumerate(runs)]


def score_each(cases: Sequence[Case], filters: Sequence[Any]) -> list[Scores]:
    """Scores of each frame by itself."""
    return [scores([case], [relight_filter]) for case, relight_filter in zip(cases, filters, strict=True)]


def mean_scores(each: Sequence[Scores]) -> Scores:
    """Mean over frames."""
    return Scores(*(float(x) for x in np.mean([dataclasses.astuple(s) for s in each], axis=0)))


def compare(name: str, own: Sequence[Scores], against: str, other: Sequence[Scores]) -> dict[str, Any]:
    """Loss against another's on the same frames: mean difference, its 95 % interval by Student's t, and percent.

    Frames of one walk are no independent rooms: the interval tells of frames like these.
    """
    difference = np.array([a.loss - b.loss for a, b in zip(own, other, strict=True)])
    mean, count, base = float(difference.mean()), len(difference), mean_scores(other).loss
    half = math.nan
    if count > 1:
        half = float(stats.t.ppf(0.975, count - 1) * difference.std(ddof=1) / math.sqrt(count))
    return {
        "schedule": name,
        "against": against,
        "frames": count,
        "difference": mean,
        "interval": None if math.isnan(half) else [mean - half, mean + half],
        "percent": 100.0 * mean / base,
        "interval_percent": None if math.isnan(half) else [100.0 * (mean + s * half) / base for s in (-1, 1)],
        "better_frames": int((difference < 0).sum()),
    }


def comparison_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of a table of what `compare` returned, each with `scene` and `time_ratio` of the medians."""
    lines = [
        "| scene | schedule | against | time | loss difference (95 %) | % (95 %) | better on |",
        "|---|---|---|---:|---|---|---:|",
    ]
    for r in rows:
        absolute, percent = f"{r['difference']:+.5f}", f"{r['percent']:+.1f}"
        if r["interval"]:
            absolute += " ({:+.5f} to {:+.5f})".format(*r["interval"])
            percent += " ({:+.1f} to {:+.1f})".format(*r["interval_percent"])
        time = f"{100 * r['time_ratio']:.0f} %"
        better = f"{r['better_frames']} of {r['frames']}"
        lines.append(
            f"| {r['scene']} | {r['schedule']} | {r['against']} | {time} | {absolute} | {percent} | {better} |"
        )
    return lines


def footer(scenes: Sequence[Scene], size: tuple[int, int]) -> list[str]:
    """What the figures hold for, as the last lines of a table."""
    record = environment()
    meshes = "; ".join(f"{scene.name}: {scene.bench.description}" for scene in scenes)
    machine = f"{record['device']}, {record['cpu_count']} cores, jax {record['versions']['jax']}"
    return ["", f"{size[0]} x {size[1]}, diffusion stage; {meshes}; {machine}."]


def write_results(out: Path, name: str, record: dict[str, Any], table: Sequence[str], figure: Figure) -> None:
    """`name` with .json, .md and .png in `out`; the table also on stdout."""
    text = "\n".join(table)
    print(text)
    write_text(out / f"{name}.md", text + "\n")
    record = record | {"peak_memory_mib": round(peak_memory_mib())} | environment()
    write_text(out / f"{name}.json", json.dumps(record, indent=2) + "\n")
    with whole(out / f"{name}.png") as temporary:
        figure.savefig(temporary, dpi=120)
