"""Empty figures."""

from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, without a window."""
    return Figure(figsize=(width, height), layout="constrained")
