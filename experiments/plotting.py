"""Figures of reports: empty ones, curves, bars."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

Curves = Mapping[str, tuple[Sequence[Any], Sequence[Any]]]
"""(x, y) by label."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, without a window."""
    return Figure(figsize=(width, height), layout="constrained")


def panels(shown: Mapping[str, Curves], style: str = "o-", **settings: Any) -> Figure:
    """Panels of curves next to each other, by title; `settings` are those of each panel's axes."""
    fig = new_figure(1 + 5 * len(shown), 4)
    for axes, (title, curves) in zip(fig.subplots(1, len(shown), squeeze=False)[0], shown.items()):
        for label, (x, y) in curves.items():
            axes.plot(x, y, style, label=label, markersize=3)
        axes.set(title=title, **settings)
    if any(len(curves) > 1 for curves in shown.values()):
        fig.axes[0].legend(fontsize=7)
    return fig


def bars(medians: Mapping[str, float], marks: Sequence[tuple[str, float]], xlabel: str, **settings: Any) -> Figure:
    """A bar for each median by label, and marks at the labels, such as their 95th percentiles."""
    fig = new_figure(7, 0.8 + 0.25 * len(medians))
    axes = fig.subplots()
    axes.barh(list(medians), list(medians.values()))
    axes.plot([value for _, value in marks], [label for label, _ in marks], "k|")
    axes.invert_yaxis()
    axes.set(xlabel=xlabel, **settings)
    return fig
