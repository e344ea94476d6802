"""Plots of a tuning run: the front of time against loss, and the effect of each choice."""

import dataclasses
from collections.abc import Callable

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from hyjax.tuning.report_points import (
    COLORS,
    FONT,
    GROUND,
    INK,
    PALE_INK,
    Point,
    draw_budgets,
    draw_front,
    fixed_ticks,
    legend,
    log_x,
    mark,
    name_budgets,
    name_points,
    style,
)
from hyjax.tuning.report_text import best_for, candidates, on_front, value_text
from hyjax.tuning.result import Candidate, Effect, Tuned

KINDS = {
    "tuned": "the front",
    "preset": "the default and presets",
    "paper": "the paper's form",
    "naive": "naive diffusion",
}
STAGE_WORDS = {"frame": "a whole frame", "cascade": "the diffusion"}
"""Stages that budgets are for, in words."""
LOSS_TICKS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
FINE_TICKS = (0.75, 0.85, 0.95, 1.05, 1.1)
"""Further ticks, where the highest loss is less than twice the lowest."""
CHANGE_TICKS = (-75, -50, -20, -10, -5, 0, 5, 10, 20, 50, 100, 200, 500, 1000)
HIGHEST_LOSS = 1.25
"""Loss, over the highest of the front and presets, at which all higher ones are drawn."""
NAMED_EFFECTS = 12
LINEAR_PERCENT = 40.0
"""Per cent beyond which an axis of changes is compressed."""


def draw_front_plot(tuned: Tuned) -> Figure:
    """Median time of a frame against loss relative to the default: tuning frames above, held-out ones below.

    Nine inches wide. What has far more loss than the front stands at the upper edge, with its loss. Small dots are
    trials, on the tuning frames that they were tried on; their times are those relative to the default, in
    milliseconds of the default at the end.
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
        most = HIGHEST_LOSS * max([1.0, *(p.y for p in points if p.front or p.kind in ("tuned", "preset"))])
        points[:] = [
            dataclasses.replace(p, y=most, name=f"{p.name}: {p.y:.2f} \u2191") if p.y > most else p for p in points
        ]
        axes.axhline(1.0, color=PALE_INK, linewidth=0.8, zorder=0)
        draw_budgets(axes, tuned.budgets)
        draw_front(axes, points)
        for point in points:
            mark(axes, point)
        values = [point.y for point in points]
        high = max([*values, 1.0])
        low = min([*values, 1.0, *(y for _, y in dots if frames == "tuning")])
        axes.set_yscale("log")
        axes.set_ylim(low / 1.06, high * 1.06)
        fixed_ticks(axes.yaxis, (*LOSS_TICKS, *FINE_TICKS) if high < 2 * low else LOSS_TICKS)
    panels[0].plot(
        [x for x, _ in dots], [y for _, y in dots], ".", color=PALE_INK, markersize=4, alpha=0.6, zorder=1
    )
    panels[-1].set_xlabel(
        f"milliseconds of {STAGE_WORDS[tuned.stage]}: median (marker) to 95th percentile (line)",
        color=INK,
        fontsize=FONT,
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
        values, time, best = scores(candidate), candidate.time, bool(best_for(tuned, candidate))
        if values is not None:
            place = candidate.name, kind, time.median, time.judged, values["relative"], not time.predicted
            found.append(Point(*place, best, on_front(tuned, candidate), named=best or kind != "tuned"))
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
        if max(high, -low) > LINEAR_PERCENT:
            scale("symlog", linthresh=10.0)
            fixed_ticks(axis, CHANGE_TICKS)
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}" if value else "0"))
        limits(low - 0.15 * (high - low), high + 0.25 * (high - low))
        draw(0.0, color=PALE_INK, linewidth=0.8, zorder=0)
    for point in points:
        axes.plot(point.x, point.y, "o", color=COLORS["tuned"], markeredgecolor=GROUND, markersize=6.5, zorder=3)
    axes.set_xlabel("change of a frame's time, %", color=INK, fontsize=FONT)
    axes.set_ylabel("change of the loss, %", color=INK, fontsize=FONT)
    figure.draw_without_rendering()
    name_points(axes, points, [])
    return figure
