"""Picture of an inspection: a few frames, their depth, and the camera's path from above."""

from pathlib import Path

import numpy as np

from hyjax.data.frames import spread
from hyjax.scene.inspection import Inspection, points_from_above
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write

SHOWN_FRAMES = 4
"""Number of frames in the picture."""


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the picture of an inspection as a PNG."""
    from matplotlib.figure import Figure

    capture = inspection.capture
    frames = []
    for index in spread(range(len(capture)), SHOWN_FRAMES):
        try:
            frames.append(capture[index])
        except InputError:
            continue
    figure = Figure(figsize=(4 * SHOWN_FRAMES, 9), layout="constrained")
    with_depth = any(frame.depth is not None for frame in frames)
    farthest = 0.0 if inspection.quantiles is None else inspection.quantiles[2]
    grid = figure.add_gridspec(3 if with_depth else 2, SHOWN_FRAMES)
    for column, frame in enumerate(frames):
        axes = figure.add_subplot(grid[0, column])
        axes.imshow(frame.image)
        axes.set_title(f"{frame.name}, {frame.time:.1f} s", fontsize=9)
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
