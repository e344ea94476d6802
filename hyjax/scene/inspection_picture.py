"""Picture of an inspection: a few frames, their depth, and the camera's path from above."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from hyjax.scene.inspection import Inspection, points_from_above
from hyjax.util.contact_sheet import GAP, contact_sheet
from hyjax.util.images import write_png

PLAN_HEIGHT, MARGIN = 420, 12
"""Of the plan from above, in pixels."""
BACKGROUND, GRID, SURFACE, PATH = "#171717", "#333333", "#999999", "#ff4033"
UNKNOWN = (0.15, 0.15, 0.4)
"""Colour of pixels without depth."""


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the picture of an inspection as a PNG."""
    frames = inspection.shown
    rows = [("pictures", [frame.image for frame in frames])]
    if depths := [frame.depth for frame in frames if frame.depth is not None]:
        farthest = depths[0].max() if inspection.quantiles is None else inspection.quantiles[2]
        shown = [np.zeros((*depths[0].shape,)) if frame.depth is None else frame.depth for frame in frames]
        label = f"depth: white 0 m, black {farthest:.1f} m and beyond, blue unknown"
        rows.append((label, [_shades(depth, farthest) for depth in shown]))
    sheet = contact_sheet(rows, [frame.title for frame in frames])
    plan = _plan(*points_from_above(inspection), sheet.shape[1] - 2 * GAP)
    label = "from above, with lines a metre apart: the surface grey, the camera's path red from its square on"
    below = contact_sheet([(label, [plan])], [""], plan.shape[1])
    write_png(path, np.concatenate([sheet, below], axis=0))


def _shades(depth: Float[np.ndarray, "h w"], farthest: float) -> Float[np.ndarray, "h w 3"]:
    grey = np.clip(1.0 - depth / max(farthest, 1e-6), 0.0, 1.0)[..., None]
    return np.where(depth[..., None] > 0, grey, UNKNOWN)


def _plan(
    surface: Float[np.ndarray, "n 2"], path: Float[np.ndarray, "m 2"], width: int
) -> Float[np.ndarray, "h w 3"]:
    """Points of a surface and a path on it, seen from above."""
    everything = np.concatenate([surface, path])
    low, high = np.quantile(everything, (0.002, 0.998), axis=0)
    low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    room = np.array([width, PLAN_HEIGHT]) - 2 * MARGIN
    pixels = (room / np.maximum(high - low, 1e-3)).min()  # a metre
    origin = np.array([width, PLAN_HEIGHT]) / 2 - pixels * (low + high) / 2

    def places(points: Float[np.ndarray, "k 2"]) -> list[tuple[float, float]]:
        column, up = np.round(origin + pixels * points).T
        return list(zip(column.tolist(), (PLAN_HEIGHT - 1 - up).tolist()))

    image = Image.new("RGB", (width, PLAN_HEIGHT), BACKGROUND)
    draw = ImageDraw.Draw(image)
    for column in np.arange(origin[0] % pixels, width, pixels):
        draw.line([(column, 0), (column, PLAN_HEIGHT)], GRID)
    for up in np.arange(origin[1] % pixels, PLAN_HEIGHT, pixels):
        draw.line([(0, PLAN_HEIGHT - 1 - up), (width, PLAN_HEIGHT - 1 - up)], GRID)
    draw.point(places(surface), SURFACE)
    walked = places(path)
    draw.line(walked, PATH, 3)
    draw.regular_polygon((*walked[0], 6), 4, fill=PATH)
    return np.asarray(image, np.float32) / 255
