"""Picture of an inspection: a few frames, their depth, and the camera's path from above."""

from pathlib import Path

import numpy as np

from hyjax.scene.inspection import SHOWN_COUNT, Inspection, points_from_above
from hyjax.util.files import atomic_write


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the picture of an inspection as a PNG."""
    from matplotlib.figure import Figure

    frames = inspection.shown
    figure = Figure(figsize=(4 * SHOWN_COUNT, 9), layout="constrained")
    with_depth = any(frame.depth is not None for frame in frames)
    farthest = 0.0 if inspection.quantiles is None else inspection.quantiles[2]
    grid = figure.add_gridspec(3 if with_depth else 2, SHOWN_COUNT)
    for column, frame in enumerate(frames):
        axes = figure.add_subplot(grid[0, column])
        axes.imshow(frame.image)
        axes.set_title(frame.title, fontsize=9)
        axes.set_axis_off()
        if frame.depth is not None:
            axes = figure.add_subplot(grid[1, column])
            depth = np.where(frame.depth > 0, frame.depth, np.nan)
            shown = axes.imshow(depth, cmap="viridis", vmin=0, vmax=farthest)
            axes.set_axis_off()
            if column == len(frames) - 1:
                figure.colorbar(shown, ax=axes, shrink=0.8, label="depth (m)")
    axes = figure.add_subplot(grid[-1, :])
    surface, path_points = points_from_above(inspection)
    axes.plot(*surface.T, ".", markersize=0.7, color="0.6", label="surface")
    axes.plot(*path_points.T, color="tab:red", linewidth=1.5, label="camera")
    axes.plot(*path_points[0], "o", color="tab:red", label="start")
    axes.set_aspect("equal")
    axes.set_xlabel("metres, seen from above")
    axes.legend(loc="upper right", fontsize=8)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")
