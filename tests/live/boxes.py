"""A floor with a box on it, looked at from around."""

import numpy as np
import trimesh

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster

UP = np.array([0.0, 0.0, 1.0])
K = Intrinsics(96, 72, 80.0, 80.0, 48.0, 36.0)
GREY = np.full((72, 96, 3), 0.5, np.float32)


def room(*, box: bool = True, far: bool = True) -> trimesh.Trimesh:
    """A floor of 6 by 6 m, a wall, and two boxes: one in the middle, one far from it."""
    parts = [
        trimesh.creation.box(bounds=[[-3, -3, -0.5], [3, 3, 0]]),
        trimesh.creation.box(bounds=[[-3, 2.6, 0], [3, 3, 2.2]]),
    ]
    if box:
        parts.append(trimesh.creation.box(bounds=[[-0.25, -0.25, 0], [0.25, 0.25, 0.5]]))
    if far:
        parts.append(trimesh.creation.box(bounds=[[2.0, 1.7, 0], [2.5, 2.2, 0.6]]))
    whole: trimesh.Trimesh = trimesh.util.concatenate(parts)
    return trimesh.Trimesh(whole.vertices, whole.faces, process=False)


def looking(at: tuple[float, float, float], count: int) -> list[Camera]:
    """Cameras on a part of a circle around a point."""
    turns = np.linspace(-2.2, -0.9, count)
    eyes = np.array(at) + np.stack([1.6 * np.cos(turns), 1.6 * np.sin(turns), np.full(count, 1.3)], axis=1)
    return [Camera(K, look_at(eye, np.array(at), UP)) for eye in eyes]


def frames(mesh: trimesh.Trimesh, cameras: list[Camera], first: int = 0) -> list[Frame]:
    """Frames with exact depth, 30 a second."""
    caster = RayCaster(mesh)
    return [
        Frame(f"{first + k:04d}", GREY, camera, (first + k) / 30, np.asarray(caster.gbuffer(camera).depth))
        for k, camera in enumerate(cameras)
    ]
