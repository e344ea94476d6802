"""Plots of a tuning run, on matplotlib's figures themselves: no window, no global state."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

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
from hyjax.tuning.report_points import (
    MARKERS,
    Point,
    draw_budgets,
    draw_front,
    legend,
    mark,
    name_budgets,
    name_points,
)
from hyjax.tuning.report_text import best_for, candidates, kind_of_baseline, on_front, time_of
from hyjax.tuning.result import Candidate, Tuned

KINDS = {
    "tuned": "tuned: the front",
    "preset": "our preset",
    "paper": "the paper's schedules",
    "naive": "naive diffusion",
}


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
    times = [time for _, points, _ in panels for point in points for time in (point.x, point.p95)]
    log_x(lower, times + [budget.milliseconds for budget in tuned.budgets])
    for axes, points, label in panels:
        style(axes)
        axes.set_ylabel(label, color=INK, fontsize=FONT)
        axes.margins(y=0.15)
        draw_budgets(axes, tuned.budgets)
        draw_front(axes, points)
        for point in points:
            mark(axes, point)
        if not points:
            axes.set_yticks([])
            axes.text(0.04, 0.5, "no scores", transform=axes.transAxes, color=QUIET, fontsize=FONT)
    log_if_wide(upper, [point.y for point in panels[0][1]])
    lower.set_xlabel("milliseconds: median (marker) to 95th percentile (line)", color=INK, fontsize=FONT)
    name_budgets(upper, tuned.budgets)
    shown = [point for _, points, _ in panels for point in points]
    legend(figure, shown, KINDS, budgets=bool(tuned.budgets))
    figure.draw_without_rendering()  # settles where things are, which placing the names needs
    for axes, points, _ in panels:
        name_points(axes, points, [budget.milliseconds for budget in tuned.budgets])
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
    for phase, sign in marks.items():
        if phase:
            axes.plot([], [], sign, color=QUIET, linestyle="none", label=f"{phase} begins")
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


def _points(tuned: Tuned, quality: Callable[[Candidate], float | None]) -> list[Point]:
    found = []
    for kind, candidate in candidates(tuned):
        y, time = quality(candidate), time_of(candidate)
        if y is None or not math.isfinite(y) or not time.median > 0:
            continue
        kind = kind if kind == "tuned" else kind_of_baseline(candidate)
        best = kind == "tuned" and bool(best_for(tuned, candidate))
        front = kind == "tuned" and on_front(tuned, candidate)
        measured = candidate.measured is not None
        named = best or kind != "tuned"
        found.append(Point(candidate.name, kind, time.median, time.p95, y, measured, best, front, named))
    return found


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
