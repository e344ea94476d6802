"""Basis of the photo's light on the points of a scan: unit windows by direction, lamps, unscanned walls."""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import CELLS, OFFSET
from hyjax.light.kinds import Aperture
from hyjax.photo_light.sources import CEILING_DISTANCE, UNSCANNED, PhotoSources, scan_top
from hyjax.util.vectors import unit

BINS = (6, 4)
"""Numbers of bins of a window's light, in azimuth and elevation. One Lambertian window does poorly."""
LOWEST_ELEVATION, HIGHEST_ELEVATION = -45.0, 45.0
"""Lowest and highest elevation of the bins, in degrees."""
SIDE_POINTS = 8
"""Number of sample points along each side of a window."""
FRAME_DEPTH = 0.08
"""Depth before a window, in metres, where bars, sills and curtains do not count as in the way."""
BLOCK_POINTS = 1 << 15
"""Number of points at a time, to bound memory."""
LAMP_CLEARANCE = 0.15
"""Distance around a lamp, in metres, where its own shade casts no shadow."""


@dataclasses.dataclass(frozen=True)
class Basis:
    """Illuminance by unknown sources of strength one.

    Attributes:
        light: illuminance of each point by each unknown.
        source: which source each unknown belongs to.
        neighbours: pairs of likely similar unknowns.
    """

    light: Float[np.ndarray, "p k"]
    names: tuple[str, ...]
    source: Int[np.ndarray, "k"]
    neighbours: Int[np.ndarray, "e 2"]


def make_basis(
    caster: RayCaster,
    hits: Int[np.ndarray, "r p"],
    position: Float[np.ndarray, "p 3"],
    normal: Float[np.ndarray, "p 3"],
    sources: PhotoSources,
    up: Float[np.ndarray, "3"],
) -> Basis:
    """Basis of all possible sources of a photo's light."""
    starts = position + OFFSET * normal
    ceiling = scan_top(caster, up)
    columns: list[np.ndarray] = []
    neighbours: list[np.ndarray] = []
    source: list[np.ndarray] = []
    names: list[str] = []

    def add(name: str, light: np.ndarray, pairs: np.ndarray) -> None:
        first = sum(c.shape[1] for c in columns)
        columns.append(light)
        neighbours.append(first + pairs.reshape(-1, 2))
        source.append(np.full(light.shape[1], len(names)))
        names.append(name)

    nothing = np.zeros((0, 2), int)
    for window in sources.windows:
        add(window.name, window_light(caster, starts, normal, window.aperture), _grid_pairs(BINS[1], BINS[0]))
    for lamp in sources.lamps:
        downwards = up if lamp.position @ up > ceiling - CEILING_DISTANCE else None
        add(lamp.name, lamp_light(caster, starts, normal, lamp.position, downwards), nothing)
    walls = _wall_light(hits, len(caster.mesh.faces))
    for name, first, count in zip(UNSCANNED, (0, 4, 5), (4, 1, 1), strict=True):
        part = slice(first * CELLS**2, (first + count) * CELLS**2)
        square = _grid_pairs(CELLS, CELLS)
        pairs = np.concatenate([square + k * CELLS**2 for k in range(count)])
        add(name, walls[:, part], pairs)
    light = np.concatenate(columns, axis=1).astype(np.float32)
    return Basis(light, tuple(names), np.concatenate(source), np.concatenate(neighbours))


def window_light(
    caster: RayCaster, starts: Float[np.ndarray, "p 3"], normal: Float[np.ndarray, "p 3"], window: Aperture
) -> Float[np.ndarray, "p k"]:
    """Illuminance by a window whose radiance times π is one in one bin of directions; rows of bins are elevations.

    E = Σ cos θ cos θ′ ΔA / (π r²) over points of the opening that are seen, shared out bilinearly between bins.
    """
    centre, right, up = (np.asarray(v, np.float64) for v in (window.center, window.right, window.up))
    inward = np.cross(right, up)
    area, inward = 4 * np.linalg.norm(inward) / SIDE_POINTS**2, unit(inward)
    ticks = (np.arange(SIDE_POINTS) + 0.5) / SIDE_POINTS * 2 - 1
    columns, lines = BINS
    light = np.zeros(len(starts) * columns * lines)
    for s, t in itertools.product(ticks, ticks):
        to = centre + s * right + t * up - starts
        squared = np.einsum("nk,nk->n", to, to)
        distance = np.sqrt(squared)
        direction = to / np.maximum(distance, 1e-6)[:, None]
        here, there = np.einsum("nk,nk->n", direction, normal), -direction @ inward
        some = np.flatnonzero((here > 0) & (there > 1e-3))
        some = some[
            ~caster.occluded(starts[some], to[some], 1 - FRAME_DEPTH / np.maximum(distance[some], 2 * FRAME_DEPTH))
        ]
        strength = here[some] * there[some] * area / (np.pi * np.maximum(squared[some], 0.01))
        azimuth = np.degrees(np.arctan2(direction[some] @ unit(right), there[some])) / 90
        elevation = np.degrees(np.arcsin(np.clip(direction[some] @ unit(up), -1, 1)))
        x = np.clip((azimuth + 1) / 2 * columns - 0.5, 0, columns - 1)
        y = np.clip(
            (elevation - LOWEST_ELEVATION) / (HIGHEST_ELEVATION - LOWEST_ELEVATION) * lines - 0.5, 0, lines - 1
        )
        x0, y0 = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), lines - 2)
        for i, j in itertools.product((0, 1), repeat=2):
            share = np.abs(1 - i - (x - x0)) * np.abs(1 - j - (y - y0)) * strength
            at = some * (columns * lines) + (y0 + j) * columns + x0 + i
            light += np.bincount(at, share, len(light))
    return light.reshape(len(starts), -1)


def lamp_light(
    caster: RayCaster,
    starts: Float[np.ndarray, "p 3"],
    normal: Float[np.ndarray, "p 3"],
    place: np.ndarray,
    up: Float[np.ndarray, "3"] | None = None,
) -> Float[np.ndarray, "p k"]:
    """Illuminance by a small lamp that shines one lux at a metre all round.

    With `up` also by a panel, which shines down by the cosine, two lux at a metre below: as much light in all.
    """
    to = np.asarray(place, np.float64) - starts
    squared = np.maximum(np.einsum("nk,nk->n", to, to), LAMP_CLEARANCE**2)
    distance = np.sqrt(squared)
    cosine = np.einsum("nk,nk->n", to, normal) / distance
    some = np.flatnonzero(cosine > 0)
    reach = 1 - LAMP_CLEARANCE / np.maximum(distance[some], 2 * LAMP_CLEARANCE)
    some = some[~caster.occluded(starts[some], to[some], reach)]
    light = np.zeros(len(starts))
    light[some] = cosine[some] / squared[some]
    if up is None:
        return light[:, None]
    return np.stack([light, light * 2 * np.maximum(to @ up, 0.0) / distance], axis=1)


def _wall_light(hits: Int[np.ndarray, "r p"], first: int) -> Float[np.ndarray, "p m"]:
    """Illuminance by each patch of the box: the share of rays that end there."""
    rays, points = hits.shape
    count = 6 * CELLS**2
    light = np.empty((points, count), np.float32)
    for start in range(0, points, BLOCK_POINTS):
        patch = hits[:, start : start + BLOCK_POINTS].astype(np.int64) - first
        here = patch.shape[1]
        at = np.where((patch >= 0) & (patch < count), patch + count * np.arange(here), here * count)
        total = np.bincount(at.ravel(), minlength=here * count + 1)[:-1]
        light[start : start + here] = total.reshape(here, count) / rays
    return light


def _grid_pairs(rows: int, columns: int) -> Int[np.ndarray, "e 2"]:
    number = np.arange(rows * columns).reshape(rows, columns)
    across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    down = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
    return np.concatenate([across, down])
