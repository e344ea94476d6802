"""Style of a report's plots, and their embedding into a page."""

import io
import math
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

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
