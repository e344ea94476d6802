"""Plots of a tuning run: the front of time against loss, and the effect of each choice."""

import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from hyjax.tuning.report_points import (
    Point,
    draw_budgets,
    draw_front,
    legend,
    mark,
    name_budgets,
    name_points,
)
from hyjax.tuning.report_text import best_for, candidates, on_front, value_text
from hyjax.tuning.result import Candidate, Effect, Tuned

# Okabe and Ito's palette, apart for the colour-blind; shapes tell the kinds apart too.
COLORS = {"tuned": "#0072b2", "paper": "#d55e00", "naive": "#009e73", "preset": "#cc79a7"}
INK, QUIET, GRID, GROUND = "#1b1f24", "#5b6570", "#d9dee3", "#fefefe"
FONT = 10


def style_legend(legend: Any) -> None:
    """Our ink, and texts taken as they are."""
    for text in legend.get_texts():
        text.set_color(INK)
        text.set_parse_math(False)


def style(axes: Axes) -> None:
    """Two quiet spines and a grid."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_edgecolor(QUIET)
    axes.tick_params(which="both", colors=QUIET, labelcolor=INK, labelsize=FONT - 0.5)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)


def log_x(axes: Axes, values: list[float]) -> None:
    """A logarithmic axis around the values, a factor of four or more wide, with plain numbers."""
    values = [value for value in values if math.isfinite(value) and value > 0] or [1.0]
    low, high = min(values) / 1.35, max(values) * 1.35
    widen = max(1.0, 4 / (high / low)) ** 0.5
    axes.set_xscale("log")
    axes.set_xlim(low / widen, high * widen)
    plain_ticks(axes.xaxis, high / low)


def plain_ticks(axis: Any, ratio: float) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 2000 else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def fixed_ticks(axis: Any, values: Sequence[float]) -> None:
    """Ticks at these values, as plain numbers."""
    axis.set_major_locator(FixedLocator(list(values)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def svg(figure: Figure, name: str, title: str) -> Markup:
    """A figure as an `<svg>` element to stand in a page, whose style sheet sets its colours.

    Args:
        figure: made here.
        name: distinguishes the element's ids from those of others in the page.
        title: what a screen reader says; as it goes into the text, without `<`, `&` or quotes.
    """
    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = re.sub(r"<!--.*?-->\s*", "", buffer.getvalue(), flags=re.DOTALL)
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#|url\(#', lambda match: f"{match[0]}{name}-", text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', rf'\1 role="img" aria-label="{title}"', text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    roles = {**COLORS, "ink": INK, "quiet": QUIET, "grid": GRID, "ground": GROUND}
    for role, color in roles.items():
        text = text.replace(color, f"var(--{role})")
    return Markup(text)


KINDS = {
    "tuned": "the front",
    "preset": "the default and presets",
    "paper": "the paper's form",
    "naive": "naive diffusion",
}
WHOLE = {"frame": "a whole frame", "cascade": "the diffusion"}
"""Stages that budgets are for, in words."""
LOSS_TICKS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
CHANGE_TICKS = (-75, -50, -20, -10, -5, 0, 5, 10, 20, 50, 100, 200, 500, 1000)
NAMED_EFFECTS = 12
WIDE = 40.0
"""Per cent beyond which an axis of changes is compressed."""


def draw_front_plot(tuned: Tuned) -> Figure:
    """Median time of a frame against loss relative to the default: tuning frames above, held-out ones below.

    Nine inches wide. Small dots are trials, on the tuning frames that they were tried on; their times are those
    relative to the default, in milliseconds of the default at the end.
    """
    held_out = any(candidate.held_out is not None for _, candidate in candidates(tuned))
    figure = Figure(figsize=(9, 7.4 if held_out else 4.6), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1 + held_out, 1, sharex=True, squeeze=False)[:, 0])
    shown = [(panels[0], _points(tuned, lambda c: c.tuning), "tuning")]
    if held_out:
        shown.append((panels[1], _points(tuned, lambda c: c.held_out), "held-out"))
    dots = trial_dots(tuned)
    every = [point for _, points, _ in shown for point in points]
    times = [time for point in every for time in (point.x, point.p95)]
    log_x(panels[-1], times + [budget.milliseconds for budget in tuned.budgets])
    for axes, points, frames in shown:
        style(axes)
        axes.set_ylabel(f"loss over the default's,\n{frames} frames", color=INK, fontsize=FONT)
        axes.axhline(1.0, color=QUIET, linewidth=0.8, zorder=0)
        draw_budgets(axes, tuned.budgets)
        draw_front(axes, points)
        for point in points:
            mark(axes, point)
        values = [point.y for point in points]
        high = max([*values, 1.0])
        low = min([*values, 1.0, *(y for _, y in dots if frames == "tuning")])
        axes.set_yscale("log")
        axes.set_ylim(low / 1.06, high * 1.06)
        fixed_ticks(axes.yaxis, LOSS_TICKS)
    panels[0].plot([x for x, _ in dots], [y for _, y in dots], ".", color=QUIET, markersize=4, alpha=0.6, zorder=1)
    panels[-1].set_xlabel(
        f"milliseconds of {WHOLE[tuned.stage]}: median (marker) to 95th percentile (line)", color=INK, fontsize=FONT
    )
    name_budgets(panels[0], tuned.budgets)
    legend(figure, every, KINDS, budgets=bool(tuned.budgets))
    figure.draw_without_rendering()  # settles where things are, which placing the names needs
    for axes, points, _ in shown:
        name_points(axes, points, [budget.milliseconds for budget in tuned.budgets])
    return figure


def trial_dots(tuned: Tuned) -> list[tuple[float, float]]:
    """(milliseconds, loss over the default's) of each trial that was timed."""
    base = next((c.time.default for c in (*tuned.best, *tuned.references)), 1.0)
    return [(t.time * base, t.loss) for t in tuned.trials if t.time is not None and t.losses]


def _points(tuned: Tuned, scores: Callable[[Candidate], dict[str, float] | None]) -> list[Point]:
    found = []
    for kind, candidate in candidates(tuned):
        told, time, best = scores(candidate), candidate.time, bool(best_for(tuned, candidate))
        if told is not None:
            front, named = on_front(tuned, candidate), best or kind != "tuned"
            label = candidate.name
            found.append(
                Point(
                    label,
                    kind,
                    time.median,
                    time.p95,
                    told["relative"],
                    measured=not time.predicted,
                    best=best,
                    front=front,
                    named=named,
                )
            )
    return found


def draw_effects(effects: list[Effect]) -> Figure:
    """Effects of single choices: time across, loss upward, in per cent. Down and left is better.

    Names are written beside those that change most.
    """
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()
    style(axes)
    largest = sorted(effects, key=lambda e: abs(e.loss - 1) + abs(e.time - 1), reverse=True)[:NAMED_EFFECTS]
    points = []
    for effect in effects:
        x, y = 100 * (effect.time - 1), 100 * (effect.loss - 1)
        name = f"{effect.parameter} {value_text(effect.value)}"
        points.append(Point(name, "tuned", x, x, y, named=effect in largest))
    for values, axis, scale, limits, draw in (
        ([p.x for p in points], axes.xaxis, axes.set_xscale, axes.set_xlim, axes.axvline),
        ([p.y for p in points], axes.yaxis, axes.set_yscale, axes.set_ylim, axes.axhline),
    ):
        low, high = min([*values, -2.0]), max([*values, 2.0])
        if max(high, -low) > WIDE:
            scale("symlog", linthresh=10.0)
            fixed_ticks(axis, CHANGE_TICKS)
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}" if value else "0"))
        limits(low - 0.15 * (high - low), high + 0.25 * (high - low))
        draw(0.0, color=QUIET, linewidth=0.8, zorder=0)
    for point in points:
        axes.plot(point.x, point.y, "o", color=COLORS["tuned"], markeredgecolor=GROUND, markersize=6.5, zorder=3)
    axes.set_xlabel("change of a frame's time, %", color=INK, fontsize=FONT)
    axes.set_ylabel("change of the loss, %", color=INK, fontsize=FONT)
    figure.draw_without_rendering()
    name_points(axes, points, [])
    return figure
