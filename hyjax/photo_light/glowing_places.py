"""Search for lamps that burn out their surroundings, too: places that are burnt out in all pictures that show them.

A lamp by night, its shade, the wall and the ceiling behind it are one burnt-out blob, which changes its form from
picture to picture and may reach the border, so that there are no middles whose rays would meet. Its place is the
volume that all these blobs share (Laurentini, *The Visual Hull Concept*, 1994).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from hyjax.geometry.raycast import RayCaster
from hyjax.photo_light.sightings import Sighting
from hyjax.photo_light.sources import Vector
from hyjax.util.vectors import orthonormal_frame

CELL_SIDE = 0.1
"""Side, in metres, of a cell of the volume."""
MOST_CELLS = 2_000_000
FEWEST_FRAMES = 3
"""Fewest pictures that show a place."""
LEAST_SHARE = 0.8
"""Least share of them in which it is burnt out."""
DARK_PICTURE = 0.45
"""Largest median value of the pictures; in brighter ones daylight burns walls and floors out, too."""
LEAST_HEIGHT = 0.9
"""Least height, in metres, of a lamp's middle above the scan's lowest surface."""
HIDDEN_DEPTH = 0.3
"""Distance, in metres, behind the scan from which a place is hidden."""
FEWEST_CELLS, MOST_LAMPS = 3, 3


def glowing_places(caster: RayCaster, sightings: Sequence[Sighting], up: Vector) -> list[Vector]:
    """Places, the largest first, of lamps of unknown form that burn out their surroundings in dark pictures."""
    if np.median([np.median(s.low) for s in sightings]) > DARK_PICTURE:
        return []
    axes = orthonormal_frame(up)
    local = np.asarray(caster.arrays.vertices, float) @ axes.T
    low, high = np.quantile(local, 0.001, axis=0), np.quantile(local, 0.999, axis=0)
    floor = low[2]
    low[2] += LEAST_HEIGHT
    shape = tuple(np.maximum(((high - low) / CELL_SIDE).astype(int) + 1, 1))
    if np.prod(shape, dtype=float) > MOST_CELLS or high[2] - floor < LEAST_HEIGHT:
        return []
    cells = np.stack(
        np.meshgrid(*(low[k] + CELL_SIDE * np.arange(shape[k]) for k in range(3)), indexing="ij"), axis=-1
    )
    places = cells.reshape(-1, 3) @ axes
    shown, burnt = np.zeros(len(places), int), np.zeros(len(places), int)
    for s in sightings:
        here, glows = _seen(s, places)
        shown += here
        burnt += here & glows
    glowing = (shown >= FEWEST_FRAMES) & (burnt >= FEWEST_FRAMES) & (burnt >= LEAST_SHARE * shown)
    labels, number = ndimage.label(glowing.reshape(shape), np.ones((3, 3, 3)))
    parts = [np.flatnonzero(labels.reshape(-1) == k) for k in range(1, number + 1)]
    parts = sorted((part for part in parts if len(part) >= FEWEST_CELLS), key=len, reverse=True)
    return [np.median(places[part], axis=0) for part in parts[:MOST_LAMPS] if 2 * len(part) >= len(parts[0])]


def _seen(s: Sighting, places: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Whether a picture shows places, and whether it is burnt out there."""
    camera, (height, width) = s.frame.camera, s.low.shape
    pixels, depth = camera.project(places)
    at = np.floor(pixels * (width / camera.intrinsics.width, height / camera.intrinsics.height))
    inside = (depth > 0.2) & (at >= 0).all(axis=1) & (at < (width, height)).all(axis=1)
    column, row = np.where(inside[:, None], at, 0).astype(int).T
    inside &= s.known[row, column] & ~(s.depth[row, column] < depth - HIDDEN_DEPTH)
    return inside, ndimage.binary_dilation(s.burnt)[row, column]
