"""Which side of a mesh the cameras see."""

import numpy as np
import pytest
import trimesh

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.winding import turned, turned_away

LENS = Intrinsics(64, 48, 45.0, 45.0, 32.0, 24.0)


def room() -> MeshArrays:
    """A room seen from inside, with a table that hangs together with nothing."""
    walls = trimesh.creation.box((4, 4, 3)).subdivide()
    walls.invert()
    table = trimesh.creation.box((1, 1, 0.8), trimesh.transformations.translation_matrix((0, 0, -1.0)))
    return MeshArrays.of(trimesh.util.concatenate([walls, table]))


def cameras() -> list[Camera]:
    angles = 2 * np.pi * np.arange(6) / 6
    eyes = [np.array([1.5 * np.cos(a), 1.5 * np.sin(a), 0.2]) for a in angles]
    return [Camera(LENS, look_at(eye, np.array([0, 0, -0.6]), np.array([0.0, 0.0, 1.0]))) for eye in eyes]


@pytest.mark.parametrize("which", ["none", "all", "table"])
def test_parts_that_show_their_back_are_turned(which: str) -> None:
    right, table = room(), np.arange(len(room().faces)) >= len(room().faces) - 12
    wrong = {"none": 0 * table, "all": 1 | table, "table": table}[which].astype(bool)
    made = turned(right, wrong)
    found = turned_away(RayCaster(made), cameras())
    np.testing.assert_array_equal(found, wrong)
    np.testing.assert_allclose(turned(made, found).face_normals, right.face_normals, atol=1e-9)


def test_vertices_at_one_place_are_one() -> None:
    """A mesh whose triangles have vertices of their own hangs together all the same."""
    right = room()
    apart = MeshArrays(right.vertices[right.faces].reshape(-1, 3), np.arange(3 * len(right.faces)).reshape(-1, 3))
    assert not turned_away(RayCaster(apart), cameras()).any()
    wrong = turned(apart, np.ones(len(apart.faces), bool))
    assert turned_away(RayCaster(wrong), cameras()).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_normals_of_a_file_are_kept_on_the_side_of_the_winding(side: float) -> None:
    right = room()
    smooth = side * (right.vertex_normals + 0.1) / np.linalg.norm(right.vertex_normals + 0.1, axis=1, keepdims=True)
    made = turned(MeshArrays(right.vertices, right.faces, smooth), np.ones(len(right.faces), bool))
    np.testing.assert_allclose(made.vertex_normals, -side * smooth, atol=1e-9)


def test_a_sheet_that_is_seen_from_both_sides_stays() -> None:
    sheet = MeshArrays(
        np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    both = [Camera(LENS, look_at(np.array([0, y, 0.0]), np.zeros(3), np.array([0, 0, 1.0]))) for y in (-2.0, 2.0)]
    assert not turned_away(RayCaster(sheet), both).any()
    fronts = [turned_away(RayCaster(sheet), [camera]).all() for camera in both]
    assert sorted(fronts) == [False, True]
