"""Search for lit lamps: small burnt-out blobs at which the rays of several frames meet inside the room."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from hyjax.geometry.raycast import RayCaster
from hyjax.light.emission import LAMP_REACH
from hyjax.photo_light.ceiling_lamps import BASELINE, LEAST_SLOPE, Blob, ceiling_lamps, ceilings_of
from hyjax.photo_light.glowing_places import HIDDEN_DEPTH, glowing_places
from hyjax.photo_light.sightings import Box, Sighting
from hyjax.photo_light.sources import CEILING_DISTANCE, PhotoLamp, PhotoWindow, Vector
from hyjax.util.vectors import orthonormal_frame

FEWEST_FRAMES = 3
FEWEST_UNSCANNED_FRAMES = 5
"""Fewest frames that must agree on a lamp outside the scan, unless `FEWEST_FRAMES` agree closely."""
LEAST_CLOSE_RADIUS = 0.05
"""Least radius, in metres, of a lamp outside the scan on which so few frames agree; less is a glint."""
FREE_DISTANCE, LEAST_FREE_SHARE = 0.2, 0.7
"""Distance, in metres, of the surface behind such a lamp, and least share of the frames in which it is that far:
paper on a table is placed a little off it."""
CLOSE_SHARE, CLOSE_RATIO = 0.25, 1.2
"""Distance of a ray from a lamp, over its radius, and ratio of two radii, up to which a frame agrees closely."""
RAY_TOLERANCE = 0.1
"""Largest distance, in metres, between rays to one lamp."""
LARGEST_RADIUS, LEAST_RADIUS = 0.35, 0.025
"""Largest and least radius of a lamp, in metres."""
LEAST_THICKNESS = 0.02
"""Least thickness of a lamp in metres; a flatter burnt-out surface is paper, a screen, a sign or a tabletop."""
FEWEST_POINTS, SURROUNDINGS = 12, 0.2
"""Fewest burnt-out points for a lamp's thickness; for fewer, all points within `SURROUNDINGS` metres are taken."""
LEAST_FOOT = 0.15
"""Least height, in metres, of a lamp's lower end above its support."""
LARGEST_REACH = 1.0
"""Largest distance, in metres, from the middle of a panel to its corner."""
LARGEST_HEIGHT_OF_FLAT = 0.8
"""Largest ratio of rows to columns of a flat lamp's blob: it is seen slant, and a globe as a disc."""
MOST_CANDIDATES = 20000
MOST_LAMPS = 16
LARGEST_SHARE = 0.05
"""Largest share of a picture in a lamp's burnt-out blob."""
LEAST_DISC = 40
"""Fewest pixels of a disc."""
LEAST_ALONE_SHARE = 0.6
"""Least share of a blob in all burnt-out pixels around it."""
DARK_VALUE, DARK_VALUE_OF_DISC = 0.75, 0.93
"""Largest display value of a lamp's surroundings; of those of a disc, as a globe before a bright wall is one."""


def search_lamps(
    caster: RayCaster,
    sightings: Sequence[Sighting],
    box: Box,
    windows: Sequence[PhotoWindow],
    up: Vector,
    panels: Sequence[PhotoLamp],
) -> list[PhotoLamp]:
    """Search for lamps beside panels, all without names; rays of cameras that hardly moved meet anywhere."""
    origins = np.stack([s.frame.camera.origin for s in sightings])
    if np.linalg.norm(np.ptp(origins, axis=0)) < BASELINE:
        return [*panels]
    blobs = [blob for number, s in enumerate(sightings) for blob in blobs_of(number, s)]
    lamps = [*panels]
    for place, radius, votes, close in _candidates(sightings, blobs):
        if not _inside(box, windows, place) or _seen_lit(sightings, place, radius) < 0.7:
            continue
        if any(np.linalg.norm(lamp.position - place) < lamp.radius + radius + RAY_TOLERANCE for lamp in lamps):
            continue
        points = _surface(sightings, place, radius)
        ceiling = _overhead(box, place)
        closely = close >= FEWEST_FRAMES and radius >= LEAST_CLOSE_RADIUS and _stands_free(sightings, place)
        if not len(points) and votes < FEWEST_UNSCANNED_FRAMES and not closely:
            continue
        if not ceiling and (is_flat(sightings, place, points) or _lies(caster, place, radius, up)):
            continue
        lamps.append(PhotoLamp("", place, radius))
    for place, radius in ceiling_lamps(list(origins), blobs, up, ceilings_of(caster, box)):
        away = [float(np.linalg.norm(lamp.position - place)) for lamp in lamps]
        if all(d > max(LARGEST_RADIUS, LAMP_REACH * lamp.radius) for d, lamp in zip(away, lamps, strict=True)):
            lamps.append(PhotoLamp("", place, radius))
    if not lamps and not windows:
        lamps = [PhotoLamp("", place, 0.0) for place in glowing_places(caster, sightings, up)]
    return [
        _as_wide_as_seen(sightings, lamp, up) if lamp.radius > 0 and _overhead(box, lamp.position) else lamp
        for lamp in lamps[:MOST_LAMPS]
    ]


def _overhead(box: Box, place: Vector) -> bool:
    """Whether a place lies close under the ceiling, or above it."""
    return bool(box[1][4] - box[0][4] @ place < CEILING_DISTANCE)


def _as_wide_as_seen(sightings: Sequence[Sighting], lamp: PhotoLamp, up: Vector) -> PhotoLamp:
    """Flat lamp of the ceiling with the reach of its burnt-out blobs in its plane; a round one as it is."""
    reaches = []
    for s, row, column, depth in _views(sightings, lamp.position, np.inf):
        if s.depth[row, column] < depth - HIDDEN_DEPTH:
            continue
        labels, _ = ndimage.label(s.burnt)
        nearest = labels[row - 1 : row + 2, column - 1 : column + 2].max()
        part = labels == nearest
        if nearest == 0 or part.sum() > LARGEST_SHARE * part.size:
            continue
        rows, columns = np.nonzero(part)
        toward, origin = s.rays[rows, columns], s.frame.camera.origin
        slope = np.min(toward @ up / np.linalg.norm(toward, axis=-1))
        if slope <= LEAST_SLOPE or np.ptp(rows) + 1 >= LARGEST_HEIGHT_OF_FLAT * (np.ptp(columns) + 1):
            continue
        along = (lamp.position - origin) @ up / (toward @ up)
        reach = np.linalg.norm(origin + along[:, None] * toward - lamp.position, axis=-1).max()
        blurred = depth * np.linalg.norm(s.rays[0, 1] - s.rays[0, 0]) / slope  # a pixel's length in the plane
        reaches.append(reach - blurred)
    reach = min(float(np.median(reaches)), LARGEST_REACH) if reaches else 0.0
    return dataclasses.replace(lamp, radius=max(lamp.radius, reach / LAMP_REACH))


def blobs_of(number: int, s: Sighting) -> list[Blob]:
    """Burnt-out blobs of a frame by themselves, on something darker; they may reach the picture's border."""
    burnt = s.burnt
    labels, _ = ndimage.label(burnt)
    found = []
    pixel = float(np.linalg.norm(s.rays[0, 1] - s.rays[0, 0]))
    for k, region in enumerate(ndimage.find_objects(labels), 1):
        part = labels[region] == k
        area = int(part.sum())
        if not 4 <= area <= LARGEST_SHARE * labels.size or part.mean() < 0.35:
            continue
        grown = tuple(slice(max(side.start - 4, 0), side.stop + 4) for side in region)
        blob = labels[grown] == k
        ring = ndimage.binary_dilation(blob, iterations=4) & ~ndimage.binary_dilation(blob, iterations=2)
        if not ring.any() or np.median(s.low[grown][ring]) > (DARK_VALUE_OF_DISC if _is_disc(part) else DARK_VALUE):
            continue
        reach = int(np.ceil(np.sqrt(area)))
        around = tuple(slice(max(side.start - reach, 0), side.stop + reach) for side in region)
        if area < LEAST_ALONE_SHARE * burnt[around].sum():
            continue  # one of many: leaves against the sky, glitter
        ray = s.rays[region][part].mean(axis=0)
        length = float(np.linalg.norm(ray))
        found.append(Blob(number, ray / length, float(np.sqrt(area / np.pi)) * pixel / length))
    return found


def _is_disc(part: Bool[np.ndarray, "h w"]) -> bool:
    """Whether a blob that fills its rectangle is round: as high as it is wide, and without the corners."""
    height, width = part.shape
    return part.sum() >= LEAST_DISC and 0.8 < height / width < 1.25 and 0.7 < part.mean() < 0.9


def _candidates(sightings: Sequence[Sighting], blobs: Sequence[Blob]) -> list[tuple[Vector, float, int, int]]:
    """Candidate places where rays to blobs of one size meet; radii; numbers of frames that agree, and closely.

    Those with most frames come first.
    """
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
    good = (np.minimum(s, t) > 0.3) & (np.maximum(s, t) < 10) & (np.linalg.norm(p - q, axis=1) < RAY_TOLERANCE)
    good &= (
        (np.maximum(first, second) < 2 * np.minimum(first, second))
        & (radius > LEAST_RADIUS)
        & (radius < LARGEST_RADIUS)
    )
    places, radii = ((p + q) / 2)[good][:MOST_CANDIDATES], radius[good][:MOST_CANDIDATES]
    votes, close = np.zeros((2, len(places)), int)
    for k in np.unique(number):
        in_frame = number == k
        to = places[:, None] - origin[in_frame]
        along = np.einsum("pbk,bk->pb", to, ray[in_frame])
        off = np.linalg.norm(to - along[..., None] * ray[in_frame], axis=-1)
        ratio = size[in_frame] * along / radii[:, None]
        agree = (along > 0) & (off < np.maximum(0.5 * radii, 0.03)[:, None]) & (ratio > 0.5) & (ratio < 2.0)
        votes += agree.any(axis=1)
        closely = agree & (off < np.maximum(CLOSE_SHARE * radii, 0.015)[:, None])
        close += (closely & (ratio > 1 / CLOSE_RATIO) & (ratio < CLOSE_RATIO)).any(axis=1)
    best = [k for k in np.lexsort((-close, -votes)) if votes[k] >= FEWEST_FRAMES]
    return [(places[k], float(radii[k]), int(votes[k]), int(close[k])) for k in best]


def _inside(box: Box, windows: Sequence[PhotoWindow], place: Vector) -> bool:
    """Whether a place lies inside the box, clear of its walls, and away from windows."""
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
    """Whether a blob lies low on a surface, nearer than the foot of any lamp."""
    x, y, _ = orthonormal_frame(up)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None]
    above = radius + 0.1  # places of what lies flat may be found a little below the surface
    around = place + above * up + (1.5 * radius + 0.05) * (np.cos(angle) * x + np.sin(angle) * y)
    down = caster.cast(around, np.broadcast_to(-up, around.shape)).distance
    return float(np.sort(down)[len(down) // 3]) < above + radius + LEAST_FOOT


def _surface(sightings: Sequence[Sighting], place: Vector, radius: float) -> Float[np.ndarray, "n 3"]:
    """Scanned points about a lamp that are burnt out."""
    points = []
    for s in sightings:
        chosen = s.burnt & (s.face >= 0)
        at = s.frame.camera.origin + s.rays[chosen] * s.depth[chosen][:, None]
        near = np.linalg.norm(at - place, axis=-1) < max(1.6 * radius, 0.08)
        points.append(at[near])
    return np.concatenate(points)


def is_flat(sightings: Sequence[Sighting], place: Vector, burnt: Float[np.ndarray, "n 3"]) -> bool:
    """Whether a burnt-out place is part of something flat, by its own points or, of few, by those about it."""
    points = burnt
    if 0 < len(burnt) < FEWEST_POINTS:
        points = np.concatenate(
            [s.frame.camera.origin + s.rays[s.face >= 0] * s.depth[s.face >= 0][:, None] for s in sightings]
        )
        points = points[np.linalg.norm(points - place, axis=-1) < SURROUNDINGS]
    if len(points) < FEWEST_POINTS:
        return False
    centred = points - points.mean(axis=0)
    # The deviation of points from the plane that fits them best.
    return float(np.sqrt(np.linalg.eigvalsh(centred.T @ centred / len(points))[0])) < LEAST_THICKNESS


def _views(
    sightings: Sequence[Sighting], place: Vector, radius: float
) -> Iterator[tuple[Sighting, int, int, float]]:
    """Sightings that show a place large enough, with its row and column there, and its depth."""
    for s in sightings:
        (x, y), depth = s.frame.camera.project(place)
        k = s.frame.camera.intrinsics
        if depth < 0.2:
            continue
        row, column = int(y / k.height * s.low.shape[0]), int(x / k.width * s.low.shape[1])
        if not (1 <= row < s.low.shape[0] - 1 and 1 <= column < s.low.shape[1] - 1):
            continue
        if radius * k.fx / depth * s.low.shape[1] / k.width >= 1.0:  # or it is too far to be seen
            yield s, row, column, float(depth)


def _stands_free(sightings: Sequence[Sighting], place: Vector) -> bool:
    """Whether what was scanned lies well behind a place, in most frames."""
    free = [
        s.depth[row, column] > depth + FREE_DISTANCE for s, row, column, depth in _views(sightings, place, np.inf)
    ]
    return bool(free) and float(np.mean(free)) >= LEAST_FREE_SHARE


def _seen_lit(sightings: Sequence[Sighting], place: Vector, radius: float) -> float:
    """Share of the frames with a free view of a place in which it is burnt out."""
    votes = []
    for s, row, column, depth in _views(sightings, place, radius):
        if s.depth[row, column] < depth - HIDDEN_DEPTH:
            continue
        votes.append(bool(s.burnt[row - 1 : row + 2, column - 1 : column + 2].any()))
    return float(np.mean(votes)) if votes else 0.0
