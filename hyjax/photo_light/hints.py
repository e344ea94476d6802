"""Windows and lamps that a capture hints at as sources of its photos' light, checked against the pictures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyjax.data.capture import Frame
from hyjax.geometry.raycast import RayCaster
from hyjax.photo_light.sources import (
    LAMP_RADIUS,
    SATURATED_VALUE,
    WALL_DISTANCE,
    PhotoLamp,
    PhotoSources,
    PhotoWindow,
    Vector,
    spoken,
)

HINT_RADIUS = 0.15
"""Radius around a hinted lamp, in metres, of the patch that decides whether it was lit."""
LIT_SHARE = 0.25 * np.pi * (LAMP_RADIUS / HINT_RADIUS) ** 2
"""Share of burnt-out pixels from which the patch counts as lit: that of a bulb in it."""
PANE_POINTS, PANE_SHARE = 9, 0.1
"""Points along each side of a window that are looked at, and the share of them that must be open or bright."""
BRIGHT_VALUE = 0.85
"""Display value of all three channels from which a point of a window counts as bright."""


def hinted_sources(
    anchors: Mapping[str, Mapping[str, Any]], up: Vector, caster: RayCaster, frames: Sequence[Frame]
) -> PhotoSources:
    """Sources hinted by a capture: its windows, and its lamps that are burnt out in the pictures."""
    windows, lamps = hinted_windows(anchors, up), []
    for name, place in sorted(anchors.items()):
        if name.startswith("lamp_"):
            position = np.asarray(place["position"], float)
            if is_lit(position, caster, frames):
                lamps.append(PhotoLamp(spoken(name), position, LAMP_RADIUS))
    return PhotoSources(windows, tuple(lamps), "capture" if windows or lamps else "none")


def hinted_windows(anchors: Mapping[str, Mapping[str, Any]], up: Vector) -> tuple[PhotoWindow, ...]:
    """Windows hinted by a capture, which need no picture."""
    windows = []
    for name, place in sorted(anchors.items()):
        if name.startswith("window_"):
            center, normal = (np.asarray(place[key], float) for key in ("center", "normal"))
            windows.append(PhotoWindow.facing(spoken(name), center, normal, up, place["width"], place["height"]))
    return tuple(windows)


def is_lit(position: Vector, caster: RayCaster, frames: Sequence[Frame]) -> bool:
    """Whether a lamp is burnt out in at least half of the pictures that see it, and in one at least."""
    votes = []
    for frame in frames:
        k = frame.camera.intrinsics
        (x, y), depth = frame.camera.project(position)
        if depth < 0.2 or not (0 <= x < k.width and 0 <= y < k.height):
            continue
        ray = position - frame.camera.origin
        length = float(np.linalg.norm(ray))
        # The lamp's own shade may stand before it.
        if caster.occluded(frame.camera.origin[None], ray[None], max(1.0 - 2 * HINT_RADIUS / length, 0.0))[0]:
            continue
        reach = max(HINT_RADIUS * k.fx / depth, 2.0)
        rows = slice(max(int(y - reach), 0), int(y + reach) + 1)
        patch = frame.image[rows, max(int(x - reach), 0) : int(x + reach) + 1]
        votes.append((patch.min(axis=-1) > SATURATED_VALUE).mean() > LIT_SHARE)
    return bool(votes) and float(np.mean(votes)) >= 0.5


def shows_light(window: PhotoWindow, caster: RayCaster, frames: Sequence[Frame]) -> bool | None:
    """Whether a window is open in the scan, or bright, in any picture of it; None if no picture shows it."""
    steps = np.linspace(-0.9, 0.9, PANE_POINTS)
    points = np.concatenate([window.center + s * window.right + steps[:, None] * window.up for s in steps])
    shown = False
    for frame in frames:
        eye, k = frame.camera.origin, frame.camera.intrinsics
        places, depth = frame.camera.project(points)
        x, y = np.nan_to_num(places.T, nan=-1.0)
        inside = (depth > 0.2) & (x >= 0) & (x < k.width) & (y >= 0) & (y < k.height)
        if (eye - window.center) @ window.normal < 0 or inside.sum() < PANE_POINTS:
            continue
        rays = points[inside] - eye
        length = np.linalg.norm(rays, axis=1)
        distance = caster.cast(np.broadcast_to(eye, rays.shape), rays / length[:, None]).distance
        free = distance > length - WALL_DISTANCE
        if free.sum() < PANE_POINTS:
            continue
        shown = True
        bright = frame.image[y[inside].astype(int), x[inside].astype(int)].min(axis=-1) > BRIGHT_VALUE
        if ((bright | (distance > length + WALL_DISTANCE)) & free).sum() > PANE_SHARE * free.sum():
            return True
    return False if shown else None
