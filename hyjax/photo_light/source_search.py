"""Search for the windows and lamps that lit photographs, in the photographs.

A window is a hole of the scan in a wall, a good part of which is burnt out in two of five frames that see it, with
some scanned wall around it that is not: a lamp before a hole burns another part in each frame, a glow fades slowly.
Where most of it was scanned, a tenth is open at least, and the wall around is darker.
A lamp is such a hole in the ceiling, a panel, unless it is large; or a small burnt-out blob inside the room at
which the rays of several frames meet, unless the scan is flat there: a sheet of paper; or one overhead on which two
frames agree (`ceiling_lamps`); or, in dark pictures, what all their burnt-out parts share (`glowing_places`). Of
what was not scanned, more frames must agree, or agree closely.
"""

import dataclasses
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from hyjax.data.capture import Capture, Frame
from hyjax.geometry.raycast import RayCaster
from hyjax.light.emission import LAMP_REACH
from hyjax.photo_light.hints import hinted_sources, shows_light
from hyjax.photo_light.lamp_search import LARGEST_REACH, search_lamps
from hyjax.photo_light.sightings import Box, Sighting, closing_box, exits, sight
from hyjax.photo_light.sources import (
    SATURATED_VALUE,
    PhotoLamp,
    PhotoSources,
    PhotoWindow,
    Vector,
    read_sources,
    source_entries,
)

CELL_SIDE = 0.05
"""Side, in metres, of a cell of a wall."""
OPENING_DEPTH = 0.06
"""Depth behind a wall's plane, in metres, from which a surface belongs to the opening."""
FEWEST_FRAMES, FEWEST_WHITE_FRAMES = 1.3, 3
"""Fewest frames that see a cell of a window, in the mean; fewest in which a cell of the wall is burnt out for it to
be of one."""
LEAST_AGREEMENT = 0.4
"""Least share of the frames that see a burnt-out cell of a window in which it is, in the mean; a lamp before a hole
burns another cell in each."""
MOST_SATURATED_SHARE = 0.5
"""Largest share of burnt-out pixels; beyond it the frames carry no information about windows."""
LEAST_AREA = 0.15
"""Least area of a window, and of what is burnt out of it, in square metres."""
LEAST_OPEN_SHARE = 0.1
"""Least share of a window that is a hole of the scan; a surface without a hole is a burnt-out wall."""
LEAST_WALL_SHARE = 0.1
"""Least scanned share of the wall close around a window. Sunlit ground behind an open place has none."""
LEAST_WALL_OF_BURNT = 0.5
"""The same of a burnt-out part of a hole; with less around, it is any part of what was not scanned."""
MOST_GROWN, GROWN_SHARE = 5, 0.8
"""Most cells that a burnt-out part grows by at each side, and least share of such a line that is a hole."""
LARGEST_VALUE_BESIDE = 0.85
"""Largest display value, in the median, of the wall within 15 cm of a window."""
LARGEST_ASPECT = 10
"""Largest ratio of a window's sides; a longer patch is a sunlit strip of ground."""
PANEL_DISTANCE = 0.05
"""Distance, in metres, of a panel's light below its ceiling."""
NEAR_LAMP = 0.35
"""Distance, in metres, up to which a lamp that is found is one that was told of."""
_log = logging.getLogger(__name__)


def search_sources(
    caster: RayCaster, frames: Sequence[Frame], up: Vector
) -> tuple[tuple[PhotoWindow, ...], tuple[PhotoLamp, ...]]:
    """Search for windows and lamps on which several frames agree."""
    sightings = [sight(caster, frame) for frame in frames]
    if not sightings or np.mean([s.burnt.mean() for s in sightings]) > MOST_SATURATED_SHARE:
        return (), ()
    box = closing_box(caster.mesh, up, np.stack([s.frame.camera.origin for s in sightings]))
    *walls, overhead = (_windows_of(wall, box, sightings, up) for wall in range(len(box[0])))
    large = [opening for opening in overhead if _reach(opening) > LARGEST_REACH]
    windows = [window for wall in (*walls, large) for window in wall]
    panels = [_panel(opening) for opening in overhead if _reach(opening) <= LARGEST_REACH]
    lamps = search_lamps(caster, sightings, box, windows, up, panels)
    return (
        tuple(dataclasses.replace(window, name=f"window-{k + 1}") for k, window in enumerate(windows)),
        tuple(dataclasses.replace(lamp, name=f"lamp-{k + 1}") for k, lamp in enumerate(lamps)),
    )


def _reach(opening: PhotoWindow) -> float:
    """Distance from the middle of an opening to its corners."""
    return float(np.linalg.norm(opening.right + opening.up))


def _panel(opening: PhotoWindow) -> PhotoLamp:
    """Lamp in the place of a small opening of the ceiling: panels are more frequent than windows there."""
    return PhotoLamp("", opening.center + PANEL_DISTANCE * opening.normal, _reach(opening) / LAMP_REACH)


def find_photo_sources(
    capture: Capture, caster: RayCaster, frames: Sequence[Frame], *, file: Path | None = None
) -> PhotoSources:
    """Windows and lamps of photographs: from a file, else from the capture's hints, else by search."""
    up = np.asarray(capture.up, float)
    if file is not None:
        given = read_sources(file, up, caster, np.stack([frame.camera.origin for frame in frames]))
        if doubted := _doubted(given, caster, frames):
            _log.warning("%s: %s is neither open nor burnt out in any picture", file, doubted)
        return _as_seen(given, [lamp.radius is None for lamp in source_entries(file)[1]], caster, frames, up)
    hinted = hinted_sources(capture.anchors, up, caster, frames)
    if doubted := _doubted(hinted, caster, frames):
        _log.warning(
            "%s: %s, which the capture names, is neither open nor burnt out in any picture; if it is wrong, name "
            "the right ones with --photo-sources",
            capture.name,
            doubted,
        )
    if hinted.windows or hinted.lamps:
        return _as_seen(hinted, [True] * len(hinted.lamps), caster, frames, up)
    windows, lamps = search_sources(caster, frames, up)
    return PhotoSources(windows, lamps, "found" if windows or lamps else "none")


def _doubted(sources: PhotoSources, caster: RayCaster, frames: Sequence[Frame]) -> str:
    """Names of the windows that no picture shows open or bright, though one shows them."""
    return ", ".join(window.name for window in sources.windows if shows_light(window, caster, frames) is False)


def _as_seen(
    sources: PhotoSources, unformed: Sequence[bool], caster: RayCaster, frames: Sequence[Frame], up: Vector
) -> PhotoSources:
    """Sources whose lamps glow, where `unformed` says that their form is not known, as the ones found there do."""
    found = [lamp for lamp in search_sources(caster, frames, up)[1] if lamp.radius] if any(unformed) else []
    lamps = list(sources.lamps)
    for number in np.flatnonzero(unformed) if found else ():
        away = [float(np.linalg.norm(seen.position - lamps[number].position)) for seen in found]
        seen = found[int(np.argmin(away))]
        if min(away) < NEAR_LAMP:
            lamps[number] = dataclasses.replace(lamps[number], radius=seen.radius)
    return dataclasses.replace(sources, lamps=tuple(lamps))


def _windows_of(wall: int, box: Box, sightings: Sequence[Sighting], up: Vector) -> list[PhotoWindow]:
    outward, offset = box[0][wall], box[1][wall]
    vertical = up if abs(outward @ up) < 0.5 else box[0][0]
    across = np.cross(vertical, -outward)
    seen = []
    for s in sightings:
        t, through = exits(box, s.frame.camera.origin, s.rays)
        chosen = through == wall
        if not chosen.any():
            continue
        origin, rays, depth = s.frame.camera.origin, s.rays[chosen], s.depth[chosen]
        place = origin + rays * t[chosen][:, None]
        behind = origin @ outward + np.where(np.isfinite(depth), depth, 1e3) * (rays @ outward) - offset
        seen.append((place @ across, place @ vertical, behind, s.low[chosen]))
    if not seen:
        return []
    low = np.array([min(part[k].min() for part in seen) for k in (0, 1)])
    high = np.array([max(part[k].max() for part in seen) for k in (0, 1)])
    low, high = np.maximum(low, high - 40.0), high  # a ray almost along the wall leaves it far away
    shape = tuple(((high - low) / CELL_SIDE).astype(int) + 1)
    keys = "open", "wall", "burnt hole", "burnt wall", "seen", "shown", "burnt"
    count = {key: np.zeros(shape, int) for key in keys}
    total, weight = np.zeros(shape), np.zeros(shape)
    for a, b, behind, value in seen:
        index = (np.stack([a, b], axis=-1) - low) / CELL_SIDE
        inside = (index >= 0).all(axis=-1)
        i, j = index[inside].astype(int).T
        behind, value = behind[inside], value[inside]
        hole, solid, burnt = behind > OPENING_DEPTH, np.abs(behind) <= 2 * OPENING_DEPTH, value > SATURATED_VALUE
        for key, which in (
            ("open", hole), ("wall", solid & ~hole), ("burnt hole", hole & burnt), ("burnt wall", solid & burnt),
            ("seen", hole | solid), ("shown", hole | (solid & burnt)), ("burnt", (hole | solid) & burnt),
        ):  # fmt: skip
            flat = np.unique(i[which] * shape[1] + j[which])
            count[key].reshape(-1)[flat] += 1
        np.add.at(total, (i[solid], j[solid]), value[solid])
        np.add.at(weight, (i[solid], j[solid]), 1.0)
    hole = (count["open"] > 0) & (count["open"] >= count["wall"])
    white = count["burnt wall"] >= FEWEST_WHITE_FRAMES
    burnt = (count["burnt hole"] > 0) | white
    agreement = count["burnt"] / np.maximum(count["seen"], 1)
    brightness = np.where(weight > 0, total / np.maximum(weight, 1.0), np.nan)
    cells = _Cells(hole | white, hole, burnt, count["wall"] > 0, count["shown"], agreement, brightness)
    windows = []
    for rectangle in _rectangles(cells):
        first = low + CELL_SIDE * np.array(rectangle[::2])
        last = low + CELL_SIDE * (np.array(rectangle[1::2]) + 1)
        (a, b), (width, height) = (first + last) / 2, last - first
        center = offset * outward + a * across + b * vertical
        windows.append(PhotoWindow("", center, across * width / 2, vertical * height / 2, -outward))
    return windows


Rectangle = tuple[int, int, int, int]
"""First and last row, first and last column."""


@dataclasses.dataclass(frozen=True)
class _Cells:
    """Cells of a wall.

    Attributes:
        mask: that may be of a window: holes, and what is burnt out in several frames.
        hole: without a surface.
        burnt: burnt out in a frame.
        wall: with a surface in the wall's plane.
        frames: number of frames that see each open or burnt out.
        agreement: share of the frames that see each in which it is burnt out.
        brightness: mean of the surface in the wall's plane; NaN without.
    """

    mask: Bool[np.ndarray, "a b"]
    hole: Bool[np.ndarray, "a b"]
    burnt: Bool[np.ndarray, "a b"]
    wall: Bool[np.ndarray, "a b"]
    frames: Int[np.ndarray, "a b"]
    agreement: Float[np.ndarray, "a b"]
    brightness: Float[np.ndarray, "a b"]


def _rectangles(cells: _Cells) -> list[Rectangle]:
    """Rectangles of windows.

    A hole may be larger than the window in it, and what is burnt out smaller: of both, what has more wall around.
    """
    found: list[tuple[float, Rectangle, Rectangle]] = []
    for mask, grows in ((cells.mask, False), (cells.mask & cells.burnt, True)):
        least_wall = LEAST_WALL_OF_BURNT if grows else LEAST_WALL_SHARE
        # Connected parts, small gaps closed and thin bridges cut.
        closed = ndimage.binary_closing(np.pad(mask, 3), np.ones((3, 3)))[3:-3, 3:-3]
        labels, number = ndimage.label(ndimage.binary_opening(closed, np.ones((3, 3))))
        for part in (labels == k for k in range(1, number + 1)):
            if part.sum() * CELL_SIDE**2 < LEAST_AREA:
                continue
            core = _middle(part)
            inside = _slices(core)
            area = part[inside].size * CELL_SIDE**2
            shining = cells.burnt[inside]
            if shining.sum() * CELL_SIDE**2 < LEAST_AREA or part[inside].mean() < 0.6 or shining.mean() < 0.25:
                continue
            if cells.agreement[inside][shining].mean() < LEAST_AGREEMENT:
                continue
            sides = sorted((core[1] - core[0], core[3] - core[2]))
            if sides[0] * CELL_SIDE < 0.25 or sides[1] > LARGEST_ASPECT * sides[0]:
                continue
            whole = _grown(core, cells.mask & ((labels == 0) | part)) if grows else core
            inside = _slices(whole)
            around = _rim(part.shape, inside)
            wall_share = float(cells.wall[around].mean()) if around.any() else 0.0
            open_share = cells.hole[inside].mean()
            if wall_share < least_wall or open_share < LEAST_OPEN_SHARE:
                continue
            if cells.frames[inside].mean() < FEWEST_FRAMES:
                continue
            beside = cells.brightness[_rim(part.shape, inside, 0, 3)]
            if _ends_sharply(beside) and (open_share >= 0.3 or _stands_out(beside, area)):
                found.append((wall_share, core, whole))
    kept: list[tuple[Rectangle, Rectangle]] = []
    for _, core, whole in sorted(found, key=lambda one: -one[0]):
        if not any(_overlap(core, other) for other, _ in kept):
            kept.append((core, whole))
    return [whole for _, whole in kept]


def _middle(part: Bool[np.ndarray, "a b"]) -> Rectangle:
    """Rectangle of the rows and columns of which a part has a good share."""
    spans = []
    for axis in (1, 0):
        profile = part.sum(axis=axis)
        lines = np.flatnonzero(profile >= 0.5 * np.quantile(profile[profile > 0], 0.9))
        spans += [int(lines[0]), int(lines[-1])]
    return spans[0], spans[1], spans[2], spans[3]


def _grown(rectangle: Rectangle, mask: Bool[np.ndarray, "a b"]) -> Rectangle:
    """Rectangle with the rows and columns beside it that are holes, too."""
    spans, ends = [*rectangle], (0, mask.shape[0] - 1, 0, mask.shape[1] - 1)
    for side in range(4):
        for _ in range(MOST_GROWN):
            if spans[side] == ends[side]:
                break
            beside = spans[side] + (1 if side % 2 else -1)
            line = mask[beside, spans[2] : spans[3] + 1] if side < 2 else mask[spans[0] : spans[1] + 1, beside]
            if line.mean() < GROWN_SHARE:
                break
            spans[side] = beside
    return spans[0], spans[1], spans[2], spans[3]


def _slices(rectangle: Rectangle) -> tuple[slice, slice]:
    return slice(rectangle[0], rectangle[1] + 1), slice(rectangle[2], rectangle[3] + 1)


def _rim(
    shape: tuple[int, int], inside: tuple[slice, slice], near: int = 2, far: int = 5
) -> Bool[np.ndarray, "a b"]:
    """Mask of the cells around a rectangle, from a number of cells to another."""
    whole = np.zeros(shape, bool)
    whole[inside] = True
    outer, inner = (ndimage.binary_dilation(whole, iterations=k) if k else whole for k in (far, near))
    return outer & ~inner


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] <= b[1] and b[0] <= a[1] and a[2] <= b[3] and b[2] <= a[3]


def _ends_sharply(beside: Float[np.ndarray, "n"]) -> bool:
    """Whether the wall beside a burnt-out part is not nearly burnt out, as in the glow of a lamp."""
    known = beside[np.isfinite(beside)]
    return not len(known) or float(np.median(known)) < LARGEST_VALUE_BESIDE


def _stands_out(beside: Float[np.ndarray, "n"], area: float) -> bool:
    """Whether a burnt-out patch of wall is a window: large, with a darker wall close around most of it."""
    known = beside[np.isfinite(beside)]
    return area >= 0.4 and len(known) > 0.5 * len(beside) and float(np.quantile(known, 0.75)) < 0.8
