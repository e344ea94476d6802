"""Search for ceiling lamps: burnt-out blobs that fall together where their rays meet one plane overhead.

Along a walk each lamp of a row is in two or three pictures only, most of them too small to be told from its
neighbours by its size. The height of the ceiling is that at which most blobs of different frames agree.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hyjax.geometry.raycast import RayCaster
from hyjax.photo_light.sightings import Box
from hyjax.photo_light.sources import Vector, scan_top
from hyjax.util.vectors import orthonormal_frame

LEAST_SLOPE = 0.1
"""Least slope of a ray to a ceiling lamp; flatter ones meet the plane anywhere."""
FARTHEST_LAMP = 8.0
"""Largest distance, in metres, of a ceiling lamp from the camera."""
HEIGHT_STEP, HEIGHT_SLACK = 0.02, 0.3
"""Step of the tried heights, and their reach beyond the scan's, in metres."""
SAME_PLACE = 0.15
"""Largest distance, in metres, between sightings of one lamp."""
FEWEST_FRAMES = 2
BASELINE = 0.2
"""Least distance, in metres, between two cameras whose rays are crossed."""
LEAST_RADIUS, LARGEST_RADIUS = 0.03, 0.35
"""Least and largest radius of a lamp, in metres; smaller ones are taken as of the least."""


@dataclasses.dataclass(frozen=True)
class Blob:
    """A burnt-out blob of a frame.

    Attributes:
        direction: unit ray to its middle.
        radius: tangent of half the angle under which it is seen.
    """

    sighting: int
    direction: Vector
    radius: float


def ceilings_of(caster: RayCaster, box: Box) -> Float[np.ndarray, "n"]:
    """Heights at which the ceiling of a scan may be."""
    up = box[0][4]
    low, high = sorted((float(box[1][4]), scan_top(caster, up)))
    return np.arange(low - HEIGHT_SLACK / 2, high + HEIGHT_SLACK, HEIGHT_STEP)


def ceiling_lamps(
    origins: Sequence[Vector], blobs: Sequence[Blob], up: Vector, heights: Float[np.ndarray, "n"]
) -> list[tuple[Vector, float]]:
    """Places and radii of ceiling lamps on which at least two frames agree, those of most frames first."""
    steep = [blob for blob in blobs if blob.direction @ up > LEAST_SLOPE]
    if len(steep) < FEWEST_FRAMES or not len(heights):
        return []
    number = np.array([blob.sighting for blob in steep])
    origin, ray = np.stack([origins[k] for k in number]), np.stack([blob.direction for blob in steep])
    size = np.array([blob.radius for blob in steep])
    level = orthonormal_frame(up)[:2]
    best: tuple[float, list[tuple[Vector, float]]] = (0.0, [])
    for height in heights:
        t = (height - origin @ up) / (ray @ up)
        near = np.flatnonzero((t > 0.3) & (t < FARTHEST_LAMP))
        place = origin[near] + t[near, None] * ray[near]
        found, score = _clusters(place, place @ level.T, origin[near], size[near] * t[near])
        if score > best[0]:
            best = score, found
    return best[1]


def _clusters(
    place: Float[np.ndarray, "n 3"],
    level: Float[np.ndarray, "n 2"],
    origin: Float[np.ndarray, "n 3"],
    radius: Float[np.ndarray, "n"],
) -> tuple[list[tuple[Vector, float]], float]:
    """Lamps that several frames place alike, and how well they do: pairs weigh more the nearer they are."""
    left, found, score = np.ones(len(place), bool), [], 0.0
    distance = np.linalg.norm(level[:, None] - level[None], axis=-1)
    alike = (distance < SAME_PLACE) & (radius[:, None] < 3 * radius[None]) & (radius[None] < 3 * radius[:, None])
    votes = np.array([_frames(origin[row]) for row in alike]) if len(place) else np.zeros(0)
    for k in np.argsort(-votes, kind="stable"):
        members = np.flatnonzero(alike[k] & left)
        if not left[k] or _frames(origin[members]) < FEWEST_FRAMES:
            continue
        left[members] = False
        size = float(np.median(radius[members]))
        # Rays of one place meet at any height: they tell where a lamp is under a ceiling that others know.
        if np.linalg.norm(origin[members] - origin[k], axis=1).max() >= BASELINE:
            score += float(np.sum(1.0 - distance[k, members] / SAME_PLACE)) - 1.0
        if size < LARGEST_RADIUS:
            found.append((place[members].mean(axis=0), max(size, LEAST_RADIUS)))
    return found, score


def _frames(origins: Float[np.ndarray, "n 3"]) -> int:
    return len({origin.tobytes() for origin in origins})
