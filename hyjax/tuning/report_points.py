"""Points in plots of time against quality, with names that do not cover each other, and the plots' style."""

import dataclasses
import io
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from matplotlib.transforms import Bbox

from hyjax.tuning.request import Budget

# Okabe and Ito's palette, apart for the colour-blind; shapes tell the kinds apart too.
COLORS = {"tuned": "#0072b2", "paper": "#d55e00", "naive": "#009e73", "preset": "#cc79a7"}
INK, PALE_INK, GRID, GROUND = "#1b1f24", "#5b6570", "#d9dee3", "#fefefe"
FONT = 10


def style(axes: Axes) -> None:
    """Two quiet spines and a grid."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_edgecolor(PALE_INK)
    axes.tick_params(which="both", colors=PALE_INK, labelcolor=INK, labelsize=FONT - 0.5)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)


def log_x(axes: Axes, values: list[float]) -> None:
    """A logarithmic axis around the values, a factor of four or more wide, with plain numbers."""
    values = [value for value in values if math.isfinite(value) and value > 0] or [1.0]
    low, high = min(values) / 1.35, max(values) * 1.35
    widen = max(1.0, 4 / (high / low)) ** 0.5
    axes.set_xscale("log")
    axes.set_xlim(low / widen, high * widen)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < 2000 else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def fixed_ticks(axis: Any, values: Sequence[float]) -> None:
    """Ticks at these values, as plain numbers."""
    axis.set_major_locator(FixedLocator(list(values)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def svg(figure: Figure, name: str, title: str) -> Markup:
    """A figure as an `<svg>` element to stand in a page, whose style sheet sets its colours.

    Args:
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
    roles = {**COLORS, "ink": INK, "quiet": PALE_INK, "grid": GRID, "ground": GROUND}
    for role, color in roles.items():
        text = text.replace(color, f"var(--{role})")
    return Markup(text)


MARKERS = {"tuned": "o", "preset": "^", "paper": "s", "naive": "D"}
# Where a label may go beside its marker, in points, best first.
PLACES = [(9, 0), (8, 10), (8, -10), (-9, 0), (-8, 10), (-8, -10), (0, 14), (0, -14)]
PLACES += [(14, 22), (14, -22), (-14, 22), (-14, -22), (22, 0), (26, 12), (26, -12)]


@dataclasses.dataclass(frozen=True)
class Point:
    """Something in a plot of time against quality.

    Attributes:
        name: what is written beside it, if it is `named`.
        x, p95: median time and its 95th percentile.
        measured: whether it was timed; hollow if not.
        best: whether it is the best for a budget.
        front: whether the line of the front goes through it.
        named: whether its name is written.
    """

    name: str
    kind: str
    x: float
    p95: float
    y: float
    measured: bool = True
    best: bool = False
    front: bool = False
    named: bool = True


def draw_budgets(axes: Axes, budgets: Sequence[Budget]) -> None:
    """A dashed line at each budget."""
    for budget in budgets:
        axes.axvline(budget.milliseconds, color=PALE_INK, linestyle=(0, (5, 4)), linewidth=1.2, zorder=1)


def draw_front(axes: Axes, points: list[Point]) -> None:
    """A line through the points of the front."""
    line = sorted((point.x, point.y) for point in points if point.front)
    axes.plot([x for x, _ in line], [y for _, y in line], color=COLORS["tuned"], linewidth=1.6, zorder=2)


def mark(axes: Axes, point: Point) -> None:
    """A marker at the median, a line from there to the 95th percentile."""
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


def name_points(axes: Axes, points: list[Point], budgets: list[float]) -> None:
    """Write names next to their markers, where they overlap least. The figure must have been laid out."""
    inside = axes.get_window_extent()
    scale = axes.get_figure().dpi / 72  # type: ignore[union-attr]

    def place(x: float, y: float) -> np.ndarray:
        return np.asarray(axes.transData.transform((x, y)))

    solid: list[Bbox] = []
    for point in points:
        x, y = place(point.x, point.y)
        solid.append(Bbox.from_extents(x - 6 * scale, y - 6 * scale, x + 6 * scale, y + 6 * scale))
        solid.append(Bbox.from_extents(x, y - scale, place(point.p95, point.y)[0], y + scale))
    line = [place(point.x, point.y) for point in sorted(points, key=lambda point: point.x) if point.front]
    dots = [a + (b - a) * t for a, b in itertools.pairwise(line) for t in np.linspace(0, 1, 50)]
    thin = [Bbox.from_extents(x, y, x, y) for x, y in dots]
    for x, _ in (place(budget, axes.get_ylim()[0]) for budget in budgets):
        thin.append(Bbox.from_extents(x, inside.y0, x, inside.y1))
    for point in sorted((p for p in points if p.named), key=lambda p: not p.best):
        tries = []
        for rank, (dx, dy) in enumerate(PLACES):
            text = _write(axes, point, dx, dy)
            box = text.get_window_extent()
            text.remove()
            outside = box.x0 < inside.x0 or box.x1 > inside.x1 or box.y0 < inside.y0 or box.y1 > inside.y1
            crossed = sum(map(box.overlaps, solid))
            cost = 30 * outside + 4 * crossed + 2 * any(map(box.overlaps, thin)) + 0.3 * rank
            tries.append((cost, dx, dy, box))
        _, dx, dy, box = min(tries)
        _write(axes, point, dx, dy)
        solid.append(box)


def _write(axes: Axes, point: Point, dx: float, dy: float) -> Text:
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


def name_budgets(axes: Axes, budgets: Sequence[Budget]) -> None:
    """Above the panel, in as many rows as it takes for the names not to touch."""
    low, high = axes.get_xlim()
    width = 560 / math.log(high / low)  # points for each unit of log time, about
    ends: list[float] = []
    for budget in sorted(budgets, key=lambda budget: budget.milliseconds):
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
            color=PALE_INK,
            fontsize=FONT,
            parse_math=False,
        )


def legend(figure: Figure, points: Sequence[Point], texts: Mapping[str, str], *, budgets: bool) -> None:
    """A legend below all panels.

    Args:
        texts: what kinds are called; `tuned` is that of the front.
    """

    def entry(label: str, **look: Any) -> Line2D:
        return Line2D([], [], label=label, **{"linestyle": "none", "marker": "o", **look})

    entries = []
    for kind, text in texts.items():
        if any(point.kind == kind for point in points):
            line = "-" if kind == "tuned" else "none"
            entries.append(entry(text, color=COLORS[kind], marker=MARKERS[kind], linestyle=line))
    if any(point.best for point in points):
        entries.append(entry("best for a budget", color=COLORS["tuned"], markersize=11))
    if any(not point.measured for point in points):
        entries.append(entry("predicted, not measured", color=GROUND, markeredgecolor=PALE_INK))
    if budgets:
        entries.append(entry("budget", color=PALE_INK, marker="", linestyle=(0, (5, 4)), linewidth=1.2))
    if entries:
        legend = figure.legend(
            handles=entries, loc="outside lower center", ncols=3, fontsize=FONT - 0.5, frameon=False
        )
        for written in legend.get_texts():
            written.set_color(INK)
            written.set_parse_math(False)
