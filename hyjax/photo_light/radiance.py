"""Radiance of the scan's vertices in the frames, in linear light."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.data.capture import MARGIN_DEPTH, Frame
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import decoded, released
from hyjax.photo_light.sources import SATURATED_VALUE

SATURATED_WEIGHT = 0.02
GRAZING_COSINE = 0.15
"""Cosine of the viewing angle below which a surface is too grazing to be read."""
DEPTH_SLACK = 0.03
"""Depth before a vertex, in metres, where surface does not hide it: the mesh is rough."""
FEWEST_SHARED = 16
"""Fewest vertices that two frames must share to compare their exposures."""
GAIN_RANGE = (0.25, 4.0)
NOISE_FLOOR = 1e-3
"""Linear value of the sensor's noise floor."""
Sample = tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]
"""Vertices seen in a frame, their linear colours, and weights."""


@dataclasses.dataclass(frozen=True)
class VertexRadiance:
    """Radiance of the vertices in the frames.

    Attributes:
        radiance: linear, in the frames' own unit; 0 where no frame shows a vertex.
        weight: how well a vertex was seen; 0 if it was not.
        gains: exposure of each frame relative to the others: their geometric mean is 1.
    """

    radiance: Float[np.ndarray, "v 3"]
    weight: Float[np.ndarray, "v"]
    gains: Float[np.ndarray, "n"]


def linear(display: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """Light of display values, in NumPy; see `hyjax.light.color.to_linear`."""
    return released(decoded(np.asarray(display, np.float64)))


def black_margin(image: Float[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Mask of the entirely black pixels near a picture's border: they show nothing, as where a lens was undone."""
    black = image.max(axis=-1) <= 0
    height, width = (max(1, math.ceil(MARGIN_DEPTH * side)) for side in black.shape)
    black[height:-height, width:-width] = False
    return black


def vertex_radiance(caster: RayCaster, frames: Iterable[Frame]) -> VertexRadiance:
    """Radiance of all vertices: the mean of their frames, after evening out the exposures."""
    seen = [_sample(caster, frame) for frame in frames]
    count = len(caster.mesh.vertices)
    gains = _exposures(seen, count)
    total, weight = np.zeros((count, 3)), np.zeros(count)
    for gain, (index, color, share) in zip(gains, seen, strict=True):
        total[index] += color / gain * share[:, None]  # a vertex is in a frame once
        weight[index] += share
    return VertexRadiance(total / np.maximum(weight, 1e-12)[:, None], weight, gains)


def _exposures(seen: Sequence[Sample], count: int) -> Float[np.ndarray, "n"]:
    """Exposure of each frame: least squares over the median ratios of frames with vertices in common."""
    logs = np.full((len(seen), count), np.nan)
    for log, (index, color, share) in zip(logs, seen, strict=True):
        clear = (share > SATURATED_WEIGHT) & (color.min(axis=1) > NOISE_FLOOR)
        log[index[clear]] = np.log(color[clear]).mean(axis=1)
    rows, ratios = [np.ones(len(seen))], [0.0]
    for i, j in itertools.combinations(range(len(seen)), 2):
        both = logs[i] - logs[j]
        both = both[np.isfinite(both)]
        if len(both) >= FEWEST_SHARED:
            row, share = np.zeros(len(seen)), np.sqrt(len(both))
            row[i], row[j] = share, -share
            rows.append(row)
            ratios.append(share * float(np.median(both)))
    # The least change where the frames do not tell: those that overlap with no other keep an exposure of 1.
    gains, *_ = np.linalg.lstsq(np.stack(rows), np.array(ratios), rcond=1e-6)
    return np.clip(np.exp(gains), *GAIN_RANGE)


def _sample(caster: RayCaster, frame: Frame) -> Sample:
    """Vertices seen in a frame, their linear colours, and weights."""
    points, normals = np.asarray(caster.mesh.vertices), np.asarray(caster.mesh.vertex_normals)
    camera = frame.camera
    (height, width), (pixel, depth) = camera.intrinsics.shape, camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = (pixel >= 1).all(axis=1) & (pixel[:, 0] < width - 1) & (pixel[:, 1] < height - 1) & (depth > 0.05)
    index = np.flatnonzero(inside)
    ray = points[index] - camera.origin
    distance = np.linalg.norm(ray, axis=1)
    cosine = -np.einsum("nk,nk->n", ray, normals[index]) / distance
    facing = cosine > GRAZING_COSINE
    index, ray, distance, cosine = index[facing], ray[facing], distance[facing], cosine[facing]
    free = ~caster.occluded(camera.origin, ray, 1 - DEPTH_SLACK / np.maximum(distance, 2 * DEPTH_SLACK))
    index, cosine = index[free], cosine[free]
    column, row = np.floor(pixel[index]).astype(int).T
    image = np.asarray(frame.image)
    known = ~black_margin(image) & np.isfinite(image).all(axis=-1)
    shown = np.all([known[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    index, cosine, column, row = index[shown], cosine[shown], column[shown], row[shown]
    # The mean over a few pixels: a vertex stands for its surroundings.
    display = np.mean([image[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    share = cosine * np.where(display.max(axis=1) > SATURATED_VALUE, SATURATED_WEIGHT, 1.0)
    return index, linear(display), share
