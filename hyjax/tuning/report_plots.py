"""Plots of a tuning run, on matplotlib's figures themselves: no window, no global state."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from hyjax.tuning.report_axes import (
    COLORS,
    FONT,
    GRID,
    GROUND,
    INK,
    QUIET,
    log_if_wide,
    log_x,
    plain_ticks,
    style,
    style_legend,
)
from hyjax.tuning.report_text import best_for, candidates, kind_of_baseline, on_front, time_of
from hyjax.tuning.result import Candidate, Tuned

MARKERS = {"tuned": "o", "preset": "^", "paper": "s", "naive": "D"}
# Where a label may go beside its marker, in points, best first.
PLACES = [(9, 0), (8, 10), (8, -10), (-9, 0), (-8, 10), (-8, -10), (0, 14), (0, -14)]
PLACES += [(14, 22), (14, -22), (-14, 22), (-14, -22), (22, 0), (26, 12), (26, -12)]

_Box = tuple[float, float, float, float]


@dataclasses.dataclass(frozen=True)
class _Point:
    name: str
    kind: str
    x: float
    p95: float
    y: float
    measured: bool
    best: bool
    front: bool


def draw_pareto(tuned: Tuned) -> Figure:
    """Time against quality of everything known: the front, our preset, the paper's schedules, naive ones, budgets.

    Above, loss on the tuning frames; below, PSNR on the held-out frames, or on the tuning frames if there are none.
    Nine inches wide. A hollow marker was not measured and stands at its predicted time.
    """
    figure = Figure(figsize=(9, 7.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    known = candidates(tuned)
    held_out = any(candidate.held_out is not None for _, candidate in known)
    frames = "held-out" if held_out else "tuning"

    def loss(candidate: Candidate) -> float | None:
        return None if candidate.tuning is None else candidate.tuning.loss

    def psnr(candidate: Candidate) -> float | None:
        scores = candidate.held_out if held_out else candidate.tuning
        return None if scores is None else scores.metrics["psnr"]

    panels = [
        (upper, _points(tuned, loss), "loss, tuning frames\n(lower is better)"),
        (lower, _points(tuned, psnr), f"PSNR, {frames} frames, dB\n(higher is better)"),
    ]
    times = [time for _, points, _ in panels for time in _times(points)]
    log_x(lower, times + [budget.milliseconds for budget in tuned.budgets])
    for axes, points, label in panels:
        style(axes)
        axes.set_ylabel(label, color=INK, fontsize=FONT)
        axes.margins(y=0.15)
        for budget in tuned.budgets:
            axes.axvline(budget.milliseconds, color=QUIET, linestyle=(0, (5, 4)), linewidth=1.2, zorder=1)
        _front(axes, points)
        for point in points:
            _mark(axes, point)
        if not points:
            axes.set_yticks([])
            axes.text(0.04, 0.5, "no scores", transform=axes.transAxes, color=QUIET, fontsize=FONT)
    log_if_wide(upper, [point.y for point in panels[0][1]])
    lower.set_xlabel("milliseconds: median (marker) to 95th percentile (line)", color=INK, fontsize=FONT)
    _name_budgets(upper, tuned)
    _legend(figure, [point for _, points, _ in panels for point in points], bool(tuned.budgets))
    figure.draw_without_rendering()  # settles where things are, which placing the names needs
    for axes, points, _ in panels:
        _name(axes, points, [budget.milliseconds for budget in tuned.budgets])
    return figure


def draw_history(tuned: Tuned) -> Figure:
    """Loss of the best so far against seconds of search, a line for each budget, a mark where each phase starts."""
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axes = figure.subplots()
    style(axes)
    axes.set_xlabel("seconds since the search began", color=INK, fontsize=FONT)
    axes.set_ylabel("loss of the best so far", color=INK, fontsize=FONT)
    steps = [e for e in tuned.history if _finite(e.get("seconds")) and _finite(e.get("loss"))]
    marks = dict(zip(dict.fromkeys(str(entry.get("phase", "")) for entry in steps), "osD^vP*Xd<>" * 9))
    for i, budget in enumerate(dict.fromkeys(str(entry.get("budget", "")) for entry in steps)):
        own = [entry for entry in steps if str(entry.get("budget", "")) == budget]
        color = list(COLORS.values())[i % len(COLORS)]
        seconds, losses = [e["seconds"] for e in own], [e["loss"] for e in own]
        axes.step(seconds, losses, where="post", color=color, linewidth=1.8)
        for j, entry in enumerate(own):
            phase = str(entry.get("phase", ""))
            if j == 0 or str(own[j - 1].get("phase", "")) != phase:
                axes.plot(seconds[j], losses[j], marks[phase], color=color, markeredgecolor=GROUND, markersize=8)
        axes.plot([], [], color=color, label=budget or "search")
    for phase, mark in marks.items():
        if phase:
            axes.plot([], [], mark, color=QUIET, linestyle="none", label=f"{phase} begins")
    log_if_wide(axes, [entry["loss"] for entry in steps])
    if steps:
        style_legend(axes.legend(fontsize=FONT - 1, frameon=False))
    else:
        axes.text(0.5, 0.5, "no steps", transform=axes.transAxes, ha="center", color=QUIET, fontsize=FONT)
    return figure


def draw_latency(tuned: Tuned) -> Figure:
    """Predicted against measured medians; the line is where they agree, the band 10% to both sides."""
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axes = figure.subplots()
    style(axes)
    known = [(kind, c) for kind, c in candidates(tuned) if c.measured is not None]
    times = [t for _, c in known if c.measured is not None for t in (c.predicted.median, c.measured.median)]
    for kind, candidate in known:
        kind = kind if kind == "tuned" else kind_of_baseline(candidate)
        mark: dict[str, Any] = {"color": COLORS[kind], "markeredgecolor": GROUND, "markersize": 8, "zorder": 3}
        axes.plot(candidate.predicted.median, time_of(candidate).median, MARKERS[kind], **mark)
    log_x(axes, times)
    axes.set_yscale("log")
    low, high = axes.get_xlim()
    axes.set_ylim(low, high)
    plain_ticks(axes.yaxis, high / low)
    line = np.array([low, high])
    axes.fill_between(line, line / 1.1, line * 1.1, color=GRID, linewidth=0, zorder=0)
    axes.plot(line, line, color=QUIET, linewidth=1, zorder=1)
    axes.set_xlabel("predicted median, ms", color=INK, fontsize=FONT)
    axes.set_ylabel("measured median, ms", color=INK, fontsize=FONT)
    return figure


def _points(tuned: Tuned, quality: Callable[[Candidate], float | None]) -> list[_Point]:
    found = []
    for kind, candidate in candidates(tuned):
        y, time = quality(candidate), time_of(candidate)
        if y is None or not math.isfinite(y) or not time.median > 0:
            continue
        kind = kind if kind == "tuned" else kind_of_baseline(candidate)
        best = kind == "tuned" and bool(best_for(tuned, candidate))
        front = kind == "tuned" and on_front(tuned, candidate)
        measured = candidate.measured is not None
        found.append(_Point(candidate.name, kind, time.median, time.p95, y, measured, best, front))
    return found


def _times(points: Iterable[_Point]) -> list[float]:
    return [time for point in points for time in (point.x, point.p95)]


def _front(axes: Axes, points: list[_Point]) -> None:
    line = sorted((point.x, point.y) for point in points if point.front)
    axes.plot([x for x, _ in line], [y for _, y in line], color=COLORS["tuned"], linewidth=1.6, zorder=2)


def _mark(axes: Axes, point: _Point) -> None:
    color = COLORS[point.kind]
    axes.plot([point.x, point.p95], [point.y, point.y], color=color, linewidth=1, alpha=0.75, zorder=2)
    axes.plot(
        point.x,
        point.y,
        MARKERS[point.kind],
        color=color if point.measured else GROUND,
        markeredgecolor=GROUND if point.measured else color,
        markeredgewidth=1.0 if point.measured else 1.6,
        markersize=11 if point.best else 6.5 if point.kind == "tuned" else 8,
        zorder=4 if point.best else 3,
    )


def _name(axes: Axes, points: list[_Point], budgets: list[float]) -> None:
    """Write the names of baselines and best schedules beside their markers, where there is least in the way."""
    inside = axes.get_window_extent()
    scale = axes.get_figure().dpi / 72  # type: ignore[union-attr]

    def place(x: float, y: float) -> np.ndarray:
        return np.asarray(axes.transData.transform((x, y)))

    solid: list[_Box] = []
    for point in points:
        x, y = place(point.x, point.y)
        solid.append((x - 6 * scale, y - 6 * scale, x + 6 * scale, y + 6 * scale))
        solid.append((x, y - scale, place(point.p95, point.y)[0], y + scale))
    line = [place(point.x, point.y) for point in sorted(points, key=lambda point: point.x) if point.front]
    dots = [a + (b - a) * t for a, b in itertools.pairwise(line) for t in np.linspace(0, 1, 50)]
    thin: list[_Box] = [(x, y, x, y) for x, y in dots]
    thin += [(x, inside.y0, x, inside.y1) for x, _ in (place(budget, axes.get_ylim()[0]) for budget in budgets)]
    for point in sorted((p for p in points if p.best or p.kind != "tuned"), key=lambda p: not p.best):
        tries = []
        for rank, (dx, dy) in enumerate(PLACES):
            text = _write(axes, point, dx, dy)
            left, low, right, high = (float(value) for value in text.get_window_extent().extents)
            text.remove()
            box = (left, low, right, high)
            outside = left < inside.x0 or right > inside.x1 or low < inside.y0 or high > inside.y1
            crossed = sum(_overlap(box, other) for other in solid)
            cost = 30 * outside + 4 * crossed + 2 * any(_overlap(box, other) for other in thin) + 0.3 * rank
            tries.append((cost, dx, dy, box))
        _, dx, dy, box = min(tries)
        _write(axes, point, dx, dy)
        solid.append(box)


def _write(axes: Axes, point: _Point, dx: float, dy: float) -> Text:
    text = axes.annotate(
        point.name,
        (point.x, point.y),
        (dx, dy),
        textcoords="offset points",
        ha="left" if dx > 0 else "right" if dx < 0 else "center",
        va="center",
        color=COLORS[point.kind],
        fontsize=FONT,
        fontweight="bold" if point.best else "normal",
        zorder=5,
        parse_math=False,
    )
    text.set_in_layout(False)
    text.set_path_effects([withStroke(linewidth=3, foreground=GROUND)])
    return text


def _overlap(a: _Box, b: _Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def _name_budgets(axes: Axes, tuned: Tuned) -> None:
    """Above the panel, in as many rows as it takes for the names not to touch."""
    low, high = axes.get_xlim()
    width = 560 / math.log(high / low)  # points for each unit of log time, about
    ends: list[float] = []
    for budget in sorted(tuned.budgets, key=lambda budget: budget.milliseconds):
        center = width * math.log(budget.milliseconds / low)
        half = 0.32 * FONT * len(budget.label) + 3
        row = next((i for i, end in enumerate(ends) if end < center - half), len(ends))
        ends[row : row + 1] = [center + half]
        axes.annotate(
            budget.label,
            (budget.milliseconds, 1),
            (0, 3 + 14 * row),
            xycoords=axes.get_xaxis_transform(),
            textcoords="offset points",
            ha="center",
            va="bottom",
            color=QUIET,
            fontsize=FONT,
            parse_math=False,
        )


def _legend(figure: Figure, points: list[_Point], budgets: bool) -> None:
    def entry(label: str, **look: Any) -> Line2D:
        return Line2D([], [], label=label, **{"linestyle": "none", "marker": "o", **look})

    entries = []
    texts = {"tuned": "tuned: the front", "preset": "our preset"}
    texts |= {"paper": "the paper's schedules", "naive": "naive diffusion"}
    for kind, text in texts.items():
        if any(point.kind == kind for point in points):
            line = "-" if kind == "tuned" else "none"
            entries.append(entry(text, color=COLORS[kind], marker=MARKERS[kind], linestyle=line))
    if any(point.best for point in points):
        entries.append(entry("best for a budget", color=COLORS["tuned"], markersize=11))
    if any(not point.measured for point in points):
        entries.append(entry("predicted, not measured", color=GROUND, markeredgecolor=QUIET))
    if budgets:
        entries.append(entry("budget", color=QUIET, marker="", linestyle=(0, (5, 4)), linewidth=1.2))
    if entries:
        legend = figure.legend(
            handles=entries, loc="outside lower center", ncols=3, fontsize=FONT - 0.5, frameon=False
        )
        style_legend(legend)


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
