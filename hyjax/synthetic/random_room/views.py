"""Hand-held camera poses in random rooms."""

import numpy as np

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.random_room.layout import RandomRoom

LEAST_DEPTH = 0.28
"""Least depth of a picture in metres."""
TRIES = 40
"""Most draws of a view."""
PROBE_RAYS = 20
"""Number of rays along a side of the picture that test a view."""


def draw_view(room: RandomRoom, caster: RayCaster, size: int, rng: np.random.Generator) -> Camera:
    """Draw a hand-held camera with objects in view: from across the room down to half a metre off a table."""
    best, best_score = None, -np.inf
    for _ in range(TRIES):
        camera = _camera(room, size, rng)
        if camera is None:
            continue
        score = _score(camera, caster)
        if score > 0:
            return camera
        if score > best_score:
            best, best_score = camera, score
    return best if best is not None else _fallback(room, size)


def _camera(room: RandomRoom, size: int, rng: np.random.Generator) -> Camera | None:
    low, high = np.array([0.12, 0.12, 0.25]), room.size - (0.12, 0.12, 0.25)
    point, extent = room.targets[rng.integers(len(room.targets))] if room.targets else (room.size / 2, 1.0)
    kind = rng.random()
    if kind < 0.35:  # from anywhere at the height of eyes or chest
        eye = np.append(rng.uniform(low[:2], high[:2]), rng.uniform(0.9, min(1.9, high[2])))
        field = rng.uniform(50, 85)
    else:  # round something, near or very near
        far = rng.uniform(1.0, 2.2) * max(extent, 0.5) if kind < 0.7 else rng.uniform(0.45, 1.1)
        turn, rise = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(5, 65))
        eye = point + far * np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        field = rng.uniform(40, 70)
    if (eye < low).any() or (eye > high).any():
        return None
    target = point + rng.normal(0, 0.15, 3) * max(0.5, extent)
    forward = target - eye
    if np.linalg.norm(forward[:2]) < 0.05:
        return None
    roll = np.radians(rng.normal(0, 3) if rng.random() < 0.85 else rng.uniform(-25, 25))
    side = np.cross(forward, (0, 0, 1))
    up = np.array([0, 0, 1.0]) * np.cos(roll) + side / np.linalg.norm(side) * np.sin(roll)
    return Camera(_intrinsics(size, field), look_at(eye, target, up))


def _intrinsics(size: int, degrees: float) -> Intrinsics:
    focal = size / 2 / np.tan(np.radians(degrees) / 2)
    return Intrinsics(size, size, focal, focal, size / 2, size / 2)


def _fallback(room: RandomRoom, size: int) -> Camera:
    """View from the middle of the room, for a room too full for others."""
    middle = room.size * (0.5, 0.5, 0.75)
    return Camera(_intrinsics(size, 75.0), look_at(middle, room.size * (0.1, 0.1, 0.1), np.array([0, 0, 1.0])))


def _score(camera: Camera, caster: RayCaster) -> float:
    """Score of a view, positive if nothing is too near, the camera in no solid, and enough to see."""
    k = camera.intrinsics
    rays = Camera(k.resize(PROBE_RAYS, PROBE_RAYS), camera.pose).rays().reshape(-1, 3)
    hits = caster.cast(camera.origin, rays)
    if hits.hit.mean() < 0.7:
        return -3.0
    depth = hits.distance[hits.hit]
    normal = caster.mesh.face_normals[hits.face[hits.hit]]
    if depth.min() < LEAST_DEPTH or (np.einsum("nk,nk->n", normal, rays[hits.hit]) > 0).mean() > 0.02:
        return -2.0 + depth.min()
    grid = np.where(hits.hit, hits.distance, 0).reshape(PROBE_RAYS, PROBE_RAYS)
    jumps = (np.abs(np.diff(np.log(np.maximum(grid, 1e-3)), axis=1)) > 0.12).mean()
    return float(jumps - 0.02)
