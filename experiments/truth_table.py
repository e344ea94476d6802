"""Tables and figure of `experiments.truth`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.blocks import Block, Picture, Plot, Table
from experiments.judging import pick
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from experiments.truth_methods import METHODS, NEW, ORACLES, PHOTO, TODAY
from hyjax.metrics import METRICS
from hyjax.synthetic.truth import DEVELOPMENT_ROOMS, TEST_ROOMS

FITS = ("raw", "fitted")
SPLITS: Mapping[str, Sequence[str]] = {"reported on": TEST_ROOMS, "chosen on": DEVELOPMENT_ROOMS}
FIRST_METRICS = "psnr", "ssim", "lpips"
"""First metrics of a line; all others of the table follow."""
OTHER_ROOMS = "other rooms"
RESAMPLES = 2000


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables, figure and pictures from the rows."""
    pictures = of_kind(rows, "picture")
    made: list[Block] = []
    groups = by_split(pictures)
    for split, own in groups.items():
        made += [whole(own, split), by_setup(own, split)]
    made.append(rooms_table(rows))
    made.append(Plot("gains", f"Fitted PSNR less that of {TODAY}, picture by picture.", figure(groups)))
    for room in dict.fromkeys(row["room"] for row in of_kind(rows, "room")):
        made.append(Picture(folder / f"{room}.png", f"Room {room}: a frame under each set-up, as it comes."))
    return made


def by_split(pictures: Sequence[Row]) -> dict[str, list[Row]]:
    """Pictures of the rooms that are reported on, that were chosen on, and of others."""
    named = {room for rooms in SPLITS.values() for room in rooms}
    groups = {split: [row for row in pictures if row["room"] in rooms] for split, rooms in SPLITS.items()}
    groups[OTHER_ROOMS] = [row for row in pictures if row["room"] not in named]
    return {split: own for split, own in groups.items() if own}


def methods_of(pictures: Sequence[Row]) -> list[str]:
    """Methods that there are, in the tables' order."""
    return [name for name in METHODS if any(name in row["methods"] for row in pictures)]


def values(pictures: Sequence[Row], method: str, fit: str, metric: str) -> np.ndarray:
    """Scores of a method, picture by picture; NaN for none. An exact picture has no finite PSNR."""
    found = [pick(row, "methods", method, fit, metric) for row in pictures]
    return np.array([np.nan if value is None else value for value in found], float)


def whole(pictures: Sequence[Row], split: str) -> Table:
    """A line for each method: means, medians, and differences to hyjax 0.1."""
    methods, shown = (
        methods_of(pictures),
        [*FIRST_METRICS, *(name for name in METRICS if name not in FIRST_METRICS)],
    )
    shown = [m for m in shown if any(np.isfinite(values(pictures, name, "raw", m)).any() for name in methods)]
    header = [""]
    for fit in FITS:
        header += [f"{fit} {METRICS[metric].label}" for metric in shown]
    header += ["fitted PSNR median", "Δ raw dB", "Δ fitted dB", "Δ fitted LPIPS", "better, raw", "better, fitted"]
    lines = []
    for name in methods:
        cells = [name if name != NEW else f"**{name}**"]
        for fit in FITS:
            cells += [_mean(pictures, name, fit, metric) for metric in shown]
        cells.append(_number(np.nanmedian(values(pictures, name, "fitted", "psnr")), 2))
        cells += [
            difference(pictures, name, fit, metric)
            for fit, metric in (("raw", "psnr"), ("fitted", "psnr"), ("fitted", "lpips"))
        ]
        cells += [share(pictures, name, fit) for fit in FITS]
        lines.append(cells)
    rooms = ", ".join(dict.fromkeys(row["room"] for row in pictures))
    caption = (
        f"Rooms {split} ({rooms}): {len(pictures)} pictures. Means; Δ: mean difference to {TODAY} with its 95 % "
        "interval (bootstrap over rooms and set-ups); better: share of the pictures with a higher PSNR than that. "
        f"From *{ORACLES[0]}* on something is told that nobody knows; the default is in bold."
    )
    return Table(caption, header, lines)


def difference(pictures: Sequence[Row], method: str, fit: str, metric: str) -> str:
    """Mean paired difference to hyjax 0.1, and its interval."""
    if method == TODAY:
        return "0"
    paired = values(pictures, method, fit, metric) - values(pictures, TODAY, fit, metric)
    clusters = [f"{row['room']} {row['setup']}" for row in pictures]
    mean, low, high = interval(paired, clusters)
    digits = METRICS[metric].digits - (metric == "lpips")
    if not np.isfinite(mean):
        return ""
    return f"{mean:+.{digits}f} ({low:+.{digits}f} to {high:+.{digits}f})"


def interval(paired: np.ndarray, clusters: Sequence[str], seed: int = 0) -> tuple[float, float, float]:
    """Mean and its 95 % interval: clusters are drawn anew, each with all its values.

    Source: Davison and Hinkley, *Bootstrap methods and their application*, 1997, section 3.8.
    """
    there = np.isfinite(paired)
    names, which = np.unique(np.asarray(clusters)[there], return_inverse=True)
    if not len(names):
        return np.nan, np.nan, np.nan
    sums, counts = np.bincount(which, paired[there]), np.bincount(which)
    drawn = np.random.default_rng(seed).integers(len(names), size=(RESAMPLES, len(names)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(sums.sum() / counts.sum()), float(low), float(high)


def share(pictures: Sequence[Row], method: str, fit: str) -> str:
    """Share of the pictures that are better than hyjax 0.1."""
    if method == TODAY:
        return ""
    own, other = (values(pictures, name, fit, "psnr") for name in (method, TODAY))
    return f"{100 * np.mean(own > other):.0f} %"


def by_setup(pictures: Sequence[Row], split: str) -> Table:
    """Raw and fitted PSNR under each set-up."""
    setups = list(dict.fromkeys(row["setup"] for row in pictures))
    lines = []
    for name in methods_of(pictures):
        cells = [name]
        for setup in setups:
            own = [row for row in pictures if row["setup"] == setup]
            cells.append(" / ".join(_mean(own, name, fit, "psnr") for fit in FITS))
        lines.append(cells)
    return Table(f"Rooms {split}: PSNR dB, raw / fitted, by set-up.", ["", *setups], lines)


def rooms_table(rows: Sequence[Row]) -> Table:
    """Table of each room: the estimate of its light, bounces, and the gain of the new default."""
    pictures, lines = of_kind(rows, "picture"), []
    setups = of_kind(rows, "setup")
    for row in of_kind(rows, "room"):
        own = [picture for picture in pictures if picture["room"] == row["room"]]
        errors = row["light_errors"]
        bounces = [s["bounces"] for s in setups if s["room"] == row["room"] and s["bounces"] is not None]
        lines.append(
            [
                row["room"],
                _number(row["again"], 1),
                f"{row['exponent']:g}",
                *(" / ".join(_number(value, 2) for value in found) for found in errors.values()),
                _number(float(np.exp(np.mean(np.log(bounces)))), 2) if bounces else "",
                difference(own, NEW, "raw", "psnr"),
                difference(own, NEW, "fitted", "psnr"),
            ]
        )
    names = next((list(row["light_errors"]) for row in of_kind(rows, "room")), [])
    header = ["", "photo rendered again, dB", "exponent", *(f"E_old, {name}" for name in names)]
    header += ["bounces", "Δ raw dB", "Δ fitted dB"]
    caption = (
        "Rooms: the photo rendered again with other noise; exponent that E_old is raised to; error of E_old at the "
        "scan's vertices, median / 90 % of |log|; estimated over true light of bounces, mean over set-ups; what "
        f"the default gains on {TODAY}."
    )
    return Table(caption, header, lines)


def figure(groups: Mapping[str, Sequence[Row]]) -> Figure:
    """Strip plot of each method's gain, a point a picture."""
    names = [n for n in methods_of([row for own in groups.values() for row in own]) if n not in (TODAY, PHOTO)]
    fig = new_figure(5.5 * len(groups) + 2, 0.34 * len(names) + 1.4)
    axes = fig.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    rng = np.random.default_rng(0)
    for ax, (split, own) in zip(axes, groups.items()):
        rooms = list(dict.fromkeys(row["room"] for row in own))
        for k, room in enumerate(rooms):
            here = [row for row in own if row["room"] == room]
            for y, name in enumerate(names):
                gain = values(here, name, "fitted", "psnr") - values(here, TODAY, "fitted", "psnr")
                place = y + rng.uniform(-0.25, 0.25, len(gain))
                ax.plot(gain, place, ".", color=f"C{k}", markersize=4, label=room if y == 0 else None)
        for y, name in enumerate(names):
            gain = values(own, name, "fitted", "psnr") - values(own, TODAY, "fitted", "psnr")
            ax.plot([np.nanmean(gain)] * 2, [y - 0.4, y + 0.4], color="black")
        ax.axvline(0, color="grey", linewidth=0.8)
        ax.set(xlabel="dB", title=f"rooms {split}")
        ax.set_yticks(range(len(names)), names)
        ax.legend(fontsize=7)
    axes[0].invert_yaxis()
    return fig


def _mean(pictures: Sequence[Row], method: str, fit: str, metric: str) -> str:
    found = values(pictures, method, fit, metric)
    return (
        ""
        if np.isnan(found).all()
        else _number(float(np.nanmean(found)), METRICS[metric].digits - (metric != "psnr"))
    )


def _number(value: Any, digits: int) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"
