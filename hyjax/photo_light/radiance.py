"""Radiance of the scan's vertices: what the frames show there, in linear light."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from hyjax.data.capture import Frame
from hyjax.geometry.raycast import RayCaster

SATURATED = 0.97
"""Display value from which a sensor no longer tells how bright something was."""
SATURATED_WEIGHT = 0.02
GRAZING = 0.15
"""Cosine below which a surface is seen too flat to be read."""
SLACK = 0.03
"""Metres of surface before a vertex that do not hide it: the mesh is rough."""
ROUNDS = 4
"""Of fitting the frames' exposures and the vertices' radiance in turns."""
GAIN_RANGE = (0.25, 4.0)
DARKEST = 1e-3
"""Linear value of the sensor's noise floor."""


@dataclasses.dataclass(frozen=True)
class VertexRadiance:
    """What the frames show of the vertices.

    Attributes:
        radiance: linear, in the frames' own unit; 0 where no frame shows a vertex.
        weight: how well a vertex was seen; 0 if it was not.
        gains: exposure of each frame relative to the others: their geometric mean is 1.
    """

    radiance: Float[np.ndarray, "v 3"]
    weight: Float[np.ndarray, "v"]
    gains: Float[np.ndarray, "n"]


def linear(display: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """sRGB → linear light, in NumPy; see `hyjax.light.color.to_linear`."""
    x = np.asarray(display, np.float64)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4)


def vertex_radiance(caster: RayCaster, frames: Iterable[Frame]) -> VertexRadiance:
    """Radiance of all vertices: the mean of the frames that show them, after evening out the frames' exposures.

    Args:
        caster: the scan.
        frames: of a capture, with their cameras.
    """
    seen = [_sample(caster, frame) for frame in frames]
    count = len(caster.mesh.vertices)
    gains = np.ones(len(seen))
    for _ in range(ROUNDS if len(seen) > 1 else 1):
        total, weight = np.zeros((count, 3)), np.zeros(count)
        for gain, (index, color, share) in zip(gains, seen):
            np.add.at(total, index, color / gain * share[:, None])
            np.add.at(weight, index, share)
        radiance = total / np.maximum(weight, 1e-12)[:, None]
        for k, (index, color, share) in enumerate(seen):
            clear = (share > SATURATED_WEIGHT) & (color.min(axis=1) > DARKEST)
            if clear.sum() > 16:
                gains[k] = np.exp(np.median(np.log(color[clear] / np.maximum(radiance[index[clear]], DARKEST))))
        gains = np.clip(gains / np.exp(np.mean(np.log(gains))), *GAIN_RANGE) if len(seen) else gains
    return VertexRadiance(radiance, weight, gains)


def _sample(
    caster: RayCaster, frame: Frame
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Vertices that a frame shows, their linear colours, and weights."""
    points, normals = np.asarray(caster.mesh.vertices), np.asarray(caster.mesh.vertex_normals)
    camera = frame.camera
    (height, width), (pixel, depth) = camera.intrinsics.shape, camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = (pixel >= 1).all(axis=1) & (pixel[:, 0] < width - 1) & (pixel[:, 1] < height - 1) & (depth > 0.05)
    index = np.flatnonzero(inside)
    ray = points[index] - camera.origin
    distance = np.linalg.norm(ray, axis=1)
    cosine = -np.einsum("nk,nk->n", ray, normals[index]) / distance
    facing = cosine > GRAZING
    index, ray, distance, cosine = index[facing], ray[facing], distance[facing], cosine[facing]
    free = ~caster.occluded(camera.origin, ray, 1 - SLACK / np.maximum(distance, 2 * SLACK))
    index, cosine = index[free], cosine[free]
    column, row = np.floor(pixel[index]).astype(int).T
    image = np.asarray(frame.image)
    # The mean over a few pixels: a vertex stands for its surroundings.
    display = np.mean([image[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    share = cosine * np.where(display.max(axis=1) > SATURATED, SATURATED_WEIGHT, 1.0)
    return index, linear(display), share
