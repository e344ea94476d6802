"""Figures need matplotlib, which nothing else here does."""

import sys
from typing import Any


def new_figure(width: float, height: float) -> Any:
    """An empty matplotlib figure, or None (and a line on stderr) without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        print("no figure: pip install 'hyjax[experiments]' brings matplotlib", file=sys.stderr)
        return None
    return Figure(figsize=(width, height), layout="constrained")
