"""Summary of a sweep: a line of the table and a mark of the figure for each configuration."""

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyjax.sweep.rows import ERROR, Row
from hyjax.util.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAMP_KEYS = {"key", "kind", "commit", "device", "seed", "seconds", "worker", "name"}
PAYLOAD_KEYS = {"files", "scene", "lights", "configuration", "frames", "size", "seed"}
MOST_LABELS = 24
"""Most configurations with a name in a figure."""


@dataclasses.dataclass(frozen=True)
class Line:
    """Line of a configuration in the summary.

    Attributes:
        name: of the configuration.
        count, errors: tasks with a result, and without one.
        means: of every number in the results.
        losses: mean loss of each scene.
    """

    name: str
    count: int
    errors: int
    means: dict[str, float]
    losses: tuple[float, ...]


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Lines of the configurations, in their order; `name` of a row is its configuration's."""
    return [
        _line(name, [row for row in rows if row["name"] == name]) for name in dict.fromkeys(r["name"] for r in rows)
    ]


def _line(name: str, rows: Sequence[Row]) -> Line:
    done = [row for row in rows if row["kind"] != ERROR]
    numbers: dict[str, list[float]] = {}
    scenes: dict[str, list[float]] = {}
    for row in done:
        for key, value in row.items():
            if (
                key not in STAMP_KEYS | PAYLOAD_KEYS
                and isinstance(value, int | float)
                and not isinstance(value, bool)
            ):
                numbers.setdefault(key, []).append(value)
        if "loss" in row:
            scenes.setdefault(row["scene"], []).append(row["loss"])
    means = {key: float(np.mean(values)) for key, values in numbers.items()}
    losses = tuple(float(np.mean(values)) for values in scenes.values())
    return Line(name, len(done), len(rows) - len(done), means, losses)


def write_csv(path: Path, lines: Sequence[Line]) -> None:
    """Write a line for each configuration, without errors first, then by loss."""
    columns = list(dict.fromkeys(key for line in lines for key in line.means))
    ordered = sorted(lines, key=lambda line: (line.errors, line.means.get("loss", np.inf)))
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["configuration", "count", "errors", *columns])
        for line in ordered:
            cells = [f"{line.means[key]:.6g}" if key in line.means else "" for key in columns]
            writer.writerow([line.name, line.count, line.errors, *cells])


def draw(lines: Sequence[Line]) -> "Figure":
    """Draw the loss of each configuration with its spread over scenes; where it was timed, against its time."""
    from matplotlib.figure import Figure

    known = sorted((line for line in lines if line.losses), key=lambda line: line.means["loss"])
    timed = [line for line in known if "median_ms" in line.means and line.means.get("default_ms")]
    figure = Figure(figsize=(12 if timed else 8, 5), layout="constrained")
    axes: Any = figure.subplots(1, 2 if timed else 1, squeeze=False)[0]
    losses = np.array([line.means["loss"] for line in known])
    below = losses - [min(line.losses) for line in known]
    above = [max(line.losses) for line in known] - losses
    spread = np.maximum(np.array([below, above]), 0.0)
    axes[0].errorbar(np.arange(len(known)), losses, spread, fmt="o", markersize=4, linewidth=1, capsize=2)
    if len(known) <= MOST_LABELS:
        names = [line.name for line in known]
        axes[0].set_xticks(np.arange(len(known)), names, rotation=45, ha="right", fontsize=8)
    else:
        axes[0].set_xlabel("configurations, least loss first")
    axes[0].set_ylabel("loss: mean, least and largest scene")
    if timed:
        ratios = {line.name: line.means["median_ms"] / line.means["default_ms"] for line in timed}
        axes[1].plot([ratios[t.name] for t in timed], [t.means["loss"] for t in timed], "o", markersize=4)
        for line in timed if len(timed) <= MOST_LABELS else ():
            place = (ratios[line.name], line.means["loss"])
            axes[1].annotate(line.name, place, xytext=(4, 3), textcoords="offset points", fontsize=8)
        axes[1].set_xlabel("time of a frame, over the default's in the same turns")
        axes[1].set_ylabel("loss")
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.3)
    return figure
