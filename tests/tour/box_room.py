"""A room of boxes, and a capture of it."""

from typing import Any

import numpy as np
import trimesh

from hyjax.data.builtin_room import UP
from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics, look_at

CUBE, TOP = np.array([[0.5, 0.4, 0.35], [0.5, 0.4, 0.7]])


def box_room() -> trimesh.Trimesh:
    """Four by five metres, 2.5 m high, with a table of a cube and a wardrobe on the floor; small triangles."""
    walls = trimesh.creation.box(bounds=[[-2, -2.5, 0], [2, 2.5, 2.5]])
    walls.invert()
    cube = trimesh.creation.box((0.7, 0.7, 0.7), trimesh.transformations.translation_matrix(CUBE))
    wardrobe = trimesh.creation.box(bounds=[[-1.9, 1.0, 0.0], [-1.4, 2.0, 1.9]])
    mesh = trimesh.util.concatenate([walls, cube, wardrobe])
    mesh = mesh.subdivide_to_size(0.25)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


class BoxCapture(Capture):
    """Two frames of grey pictures in that room."""

    name, up, fingerprint = "box", UP, "box"

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> Any:
        k = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
        pose = look_at(np.array([-1.2 + 0.3 * index, -2.2, 1.5]), CUBE, UP)
        image = np.random.default_rng(index).uniform(0.3, 0.7, (48, 64, 3)).astype(np.float32)
        return Frame(f"{index}", image, Camera(k, pose), float(index))


def moved(by: tuple[float, float, float], degrees: float = 0.0) -> tuple[float, ...]:
    pose = trimesh.transformations.rotation_matrix(np.deg2rad(degrees), UP)
    pose[:3, 3] += by
    return tuple(pose.reshape(-1).tolist())
