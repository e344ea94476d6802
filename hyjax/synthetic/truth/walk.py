"""Walks through random rooms: positions around the room at eye height, looking across it."""

import numpy as np

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster

LEAST_DEPTH = 0.35
"""Least depth of a picture in metres."""
TRIES = 30
"""Most draws of a pose."""
PROBE_RAYS = 20
"""Number of rays along a side of the picture that test a view."""
EYE_HEIGHTS = (1.3, 1.6)
FIELD_DEGREES = 66.0
"""Horizontal field of view of a photo in degrees."""


def walk(
    caster: RayCaster, size: np.ndarray, seed: tuple[int, ...], field: float, n_frames: int, width: int, height: int
) -> list[Camera]:
    """Walk of `n_frames` poses once round a room of inner `size`, `field` degrees wide; they see across it.

    Args:
        size: width, depth and height in metres, one corner at the origin.
        field: degrees across a picture.
    """
    focal = width / 2 / np.tan(np.radians(field) / 2)
    intrinsics = Intrinsics(width, height, focal, focal, width / 2, height / 2)
    rng = np.random.default_rng((*seed, 4))
    cameras = []
    for k in range(n_frames):
        best, best_score = None, -np.inf
        for _ in range(TRIES):
            camera = Camera(intrinsics, _pose(size, 2 * np.pi * (k + rng.uniform(-0.4, 0.4)) / n_frames, rng))
            score = _score(caster, camera)
            if score > best_score:
                best, best_score = camera, score
        assert best is not None
        cameras.append(best)
    return cameras


def _pose(size: np.ndarray, angle: float, rng: np.random.Generator) -> np.ndarray:
    """Random pose between the room's middle and its walls in the direction `angle`, looking to the other side."""
    way = np.array([np.cos(angle), np.sin(angle)])
    reach = (size[:2] / 2 - 0.25) / np.maximum(np.abs(way), 1e-6)
    out = way * min(reach) * rng.uniform(0.3, 1.0)
    eye = np.append(size[:2] / 2 + out, rng.uniform(*EYE_HEIGHTS))
    aside = np.array([-way[1], way[0]]) * rng.uniform(-0.5, 0.5) * size[:2]
    target = np.append(size[:2] / 2 - 0.7 * out + aside, rng.uniform(0.5, 1.1))
    if np.linalg.norm((target - eye)[:2]) < 0.5:
        target[:2] = eye[:2] - 0.6 * way
    return look_at(eye, target, np.array([*rng.normal(0, 0.012, 2), 1.0]))


def _score(caster: RayCaster, camera: Camera) -> float:
    """Score of a view: high if it is far, varied and from outside solids."""
    rays = Camera(camera.intrinsics.resize(PROBE_RAYS, PROBE_RAYS), camera.pose).rays().reshape(-1, 3)
    hits = caster.cast(camera.origin, rays)
    seen = hits.hit
    if seen.mean() < 0.75:
        return -10.0
    depth = hits.distance[seen]
    normal = np.asarray(caster.mesh.face_normals)[hits.face[seen]]
    if depth.min() < LEAST_DEPTH or (np.einsum("nk,nk->n", normal, rays[seen]) > 0).mean() > 0.01:
        return -5.0 + min(depth.min(), LEAST_DEPTH)
    grid = np.where(seen, hits.distance, 6.0).reshape(PROBE_RAYS, PROBE_RAYS)
    jumps = (np.abs(np.diff(np.log(grid), axis=1)) > 0.12).mean()
    return float(np.median(depth) + 0.5 * depth.min() + 2.0 * min(jumps, 0.25))
