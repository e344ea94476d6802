"""Search for lit lamps: small burnt-out blobs at which the rays of several frames meet inside the room."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from hyjax.geometry.raycast import RayCaster
from hyjax.photo_light.sightings import Box, Sighting
from hyjax.photo_light.sources import PhotoLamp, PhotoWindow, Vector
from hyjax.util.vectors import orthonormal_frame

FEWEST_FRAMES = 3
FEWEST_UNSCANNED = 5
"""Frames for a lamp that the scan does not have."""
BASELINE = 0.2
"""Metres between two cameras whose rays are crossed."""
MISS = 0.1
"""Metres by which rays to one lamp may miss each other."""
LARGEST, LEAST = 0.35, 0.025
"""Radius of a lamp in metres."""
FLAT = 0.02
"""Metres: what is burnt out and flatter than this is a sheet of paper, a screen or a tabletop."""
FOOT = 0.15
"""Metres between a lamp's lower end and what it stands on, at least."""
MOST_CANDIDATES = 20000
DARK = 0.75
"""Display value that the surroundings of a lamp stay below."""


@dataclasses.dataclass(frozen=True)
class Blob:
    """A burnt-out blob of a frame.

    Attributes:
        sighting: number of its frame.
        direction: unit ray to its middle.
        radius: tangent of half the angle under which it is seen.
    """

    sighting: int
    direction: Vector
    radius: float


def search_lamps(
    caster: RayCaster, sightings: Sequence[Sighting], box: Box, windows: Sequence[PhotoWindow], up: Vector
) -> tuple[PhotoLamp, ...]:
    """Lamps that at least three frames agree on."""
    blobs = [blob for number, s in enumerate(sightings) for blob in blobs_of(number, s)]
    lamps: list[PhotoLamp] = []
    for place, radius, votes in _candidates(sightings, blobs):
        if not _inside(box, windows, place) or _seen_lit(sightings, place) < 0.7:
            continue
        if any(np.linalg.norm(lamp.position - place) < lamp.radius + radius + MISS for lamp in lamps):
            continue
        points, faces = _surface(sightings, place, radius)
        ceiling = bool(box[1][4] - box[0][4] @ place < 0.25)
        if not len(points) and votes < FEWEST_UNSCANNED:
            continue
        flat = len(points) >= 12 and _thickness(points) < FLAT
        if not ceiling and (flat or _lies(caster, place, radius, up)):
            continue
        lamps.append(PhotoLamp(f"lamp-{len(lamps) + 1}", place, radius, faces))
    return tuple(lamps)


def blobs_of(number: int, s: Sighting) -> list[Blob]:
    """Small burnt-out blobs of a frame that lie whole in it, on something darker."""
    labels, _ = ndimage.label(s.burnt)
    found = []
    pixel = float(np.linalg.norm(s.rays[0, 1] - s.rays[0, 0]))
    for k, place in enumerate(ndimage.find_objects(labels), 1):
        part = labels[place] == k
        area = int(part.sum())
        rows, columns = place
        at_border = rows.start == 0 or columns.start == 0 or rows.stop == labels.shape[0]
        if not 4 <= area <= 0.02 * labels.size or at_border or columns.stop == labels.shape[1]:
            continue
        grown = tuple(slice(max(side.start - 4, 0), side.stop + 4) for side in place)
        whole = labels[grown] == k
        ring = ndimage.binary_dilation(whole, iterations=4) & ~ndimage.binary_dilation(whole, iterations=2)
        if np.median(s.low[grown][ring]) > DARK or part.mean() < 0.4:
            continue
        ray = s.rays[place][part].mean(axis=0)
        length = float(np.linalg.norm(ray))
        found.append(Blob(number, ray / length, float(np.sqrt(area / np.pi)) * pixel / length))
    return found


def _candidates(sightings: Sequence[Sighting], blobs: Sequence[Blob]) -> list[tuple[Vector, float, int]]:
    """Places at which the rays to blobs of one size meet in enough frames; radii; number of frames, most first."""
    if len(blobs) < FEWEST_FRAMES:
        return []
    number = np.array([blob.sighting for blob in blobs])
    origin = np.stack([sightings[k].frame.camera.origin for k in number])
    ray, size = np.stack([blob.direction for blob in blobs]), np.array([blob.radius for blob in blobs])
    i, j = np.triu_indices(len(blobs), 1)
    between, cosine = origin[j] - origin[i], np.einsum("nk,nk->n", ray[i], ray[j])
    wide = (np.linalg.norm(between, axis=1) >= BASELINE) & (cosine < 0.9995)
    i, j, between, cosine = i[wide], j[wide], between[wide], cosine[wide]
    a, b = np.einsum("nk,nk->n", ray[i], between), np.einsum("nk,nk->n", ray[j], between)
    s, t = (a - cosine * b) / (1 - cosine**2), (cosine * a - b) / (1 - cosine**2)
    p, q = origin[i] + s[:, None] * ray[i], origin[j] + t[:, None] * ray[j]
    first, second = s * size[i], t * size[j]
    radius = (first + second) / 2
    good = (np.minimum(s, t) > 0.3) & (np.maximum(s, t) < 10) & (np.linalg.norm(p - q, axis=1) < MISS)
    good &= (np.maximum(first, second) < 2 * np.minimum(first, second)) & (radius > LEAST) & (radius < LARGEST)
    places, radii = ((p + q) / 2)[good][:MOST_CANDIDATES], radius[good][:MOST_CANDIDATES]
    votes = np.zeros(len(places), int)
    for k in np.unique(number):
        own = number == k
        to = places[:, None] - origin[own]
        along = np.einsum("pbk,bk->pb", to, ray[own])
        off = np.linalg.norm(to - along[..., None] * ray[own], axis=-1)
        ratio = size[own] * along / radii[:, None]
        agree = (along > 0) & (off < np.maximum(0.5 * radii, 0.03)[:, None]) & (ratio > 0.5) & (ratio < 2.0)
        votes += agree.any(axis=1)
    best = [k for k in np.argsort(-votes, kind="stable") if votes[k] >= FEWEST_FRAMES]
    return [(places[k], float(radii[k]), int(votes[k])) for k in best]


def _inside(box: Box, windows: Sequence[PhotoWindow], place: Vector) -> bool:
    """Whether a place lies inside the box, clear of its walls, and at no window."""
    clear = box[1] - box[0] @ place
    if (clear[:4] < 0.05).any() or clear[4] < -0.1:
        return False
    for window in windows:
        offset = place - window.center
        right, high = (np.linalg.norm(side) for side in (window.right, window.up))
        beside = abs(offset @ window.right) < right * (right + 0.2) and abs(offset @ window.up) < high * (
            high + 0.2
        )
        if beside and offset @ window.normal < 0.4:
            return False
    return True


def _lies(caster: RayCaster, place: Vector, radius: float, up: Vector) -> bool:
    """Whether something lies or stands low on a table: its foot is nearer than that of any lamp."""
    x, y, _ = orthonormal_frame(up)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None]
    above = radius + 0.1  # places of what lies flat may be found a little below the surface
    around = place + above * up + (1.5 * radius + 0.05) * (np.cos(angle) * x + np.sin(angle) * y)
    down = caster.cast(around, np.broadcast_to(-up, around.shape)).distance
    return float(np.sort(down)[len(down) // 3]) < above + radius + FOOT


def _surface(
    sightings: Sequence[Sighting], place: Vector, radius: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f"]]:
    """Scanned points about a lamp that are burnt out, and the triangles that they lie on."""
    points, faces = [], []
    for s in sightings:
        chosen = s.burnt & (s.face >= 0)
        at = s.frame.camera.origin + s.rays[chosen] * s.depth[chosen][:, None]
        near = np.linalg.norm(at - place, axis=-1) < max(1.6 * radius, 0.08)
        points.append(at[near])
        faces.append(s.face[chosen][near])
    return np.concatenate(points), np.unique(np.concatenate(faces))


def _thickness(points: Float[np.ndarray, "n 3"]) -> float:
    """Deviation of points from the plane that fits them best."""
    centred = points - points.mean(axis=0)
    return float(np.sqrt(np.linalg.eigvalsh(centred.T @ centred / len(points))[0]))


def _seen_lit(sightings: Sequence[Sighting], place: Vector) -> float:
    """Share of the frames with a free view of a place in which it is burnt out."""
    votes = []
    for s in sightings:
        (x, y), depth = s.frame.camera.project(place)
        k = s.frame.camera.intrinsics
        row, column = int(y / k.height * s.low.shape[0]), int(x / k.width * s.low.shape[1])
        if depth < 0.2 or not (1 <= row < s.low.shape[0] - 1 and 1 <= column < s.low.shape[1] - 1):
            continue
        if s.depth[row, column] < depth - 0.3:
            continue
        votes.append(bool(s.burnt[row - 1 : row + 2, column - 1 : column + 2].any()))
    return float(np.mean(votes)) if votes else 0.0
