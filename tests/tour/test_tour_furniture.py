"""Furniture: found from a point on it, and cast where it has been moved to."""

import numpy as np
import pytest
import trimesh
from extras import need

need("tour")

from box_room import CUBE, TOP, box_room, moved

from hyjax.data.builtin_room import UP
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.mesh import submesh
from hyjax.geometry.raycast import RayCaster
from hyjax.tour.furniture import Part, merge_gbuffers, piece_at, shell


def test_floor_ceiling_and_walls_are_no_furniture() -> None:
    mesh = box_room()
    found = shell(mesh, UP)
    centres, corners = mesh.triangles_center, mesh.bounds
    on_wall = (np.abs(centres - corners[0]).min(axis=1) < 1e-6) | (np.abs(centres - corners[1]).min(axis=1) < 1e-6)
    assert found[on_wall].all()
    assert not found[np.abs(centres[:, 2] - 0.7) < 1e-6].any(), "the top of the cube is not"
    assert piece_at(mesh, np.array([0.0, 0.0, 0.0]), UP) is None


@pytest.mark.parametrize("missing", [[0, 0, 1], [1, 0, 0], [0, -1, 0]])
def test_a_side_that_was_not_scanned_makes_no_shell_of_what_stands_there(missing: list[int]) -> None:
    """As with phones, which are seldom pointed at the ceiling."""
    mesh = box_room()
    side = np.asarray(missing)
    open_side = np.abs(mesh.triangles_center @ side - (mesh.bounds @ side).max()) < 1e-6
    mesh.update_faces(~open_side)
    found = piece_at(mesh, TOP, UP)
    assert found is not None and mesh.area_faces[found].sum() > 0.49 + 4 * 0.7 * 0.4
    assert np.abs(mesh.triangles_center[found] - CUBE).max() < 0.36
    assert shell(mesh, UP)[np.abs(mesh.triangles_center[:, 2]) < 1e-6].all(), "the floor is"


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_click_finds_the_whole_piece_and_nothing_else(turn: float) -> None:
    mesh = box_room()
    pose = trimesh.transformations.rotation_matrix(turn, UP)
    mesh.apply_transform(pose)
    faces = piece_at(mesh, trimesh.transform_points(TOP[None], pose)[0], UP)
    assert faces is not None
    found = trimesh.transform_points(mesh.triangles_center[faces], np.linalg.inv(pose)) - CUBE
    assert np.abs(found).max() < 0.36, "nothing else"
    high = found[:, 2] > -0.25
    assert mesh.area_faces[faces][high].sum() > 0.49 + 4 * 0.7 * 0.4, "all of it but its foot on the floor"


def test_a_moved_part_is_cast_where_it_is() -> None:
    """Against a caster of the moved mesh."""
    mesh = box_room()
    faces = piece_at(mesh, TOP, UP)
    assert faces is not None
    piece, rest = submesh(mesh, faces), submesh(mesh, ~faces)
    pose = np.asarray(moved((0.4, -0.8, 0.1), 30.0)).reshape(4, 4)
    whole = trimesh.util.concatenate([rest, piece.copy().apply_transform(pose)])
    camera = Camera(Intrinsics(80, 60, 50.0, 50.0, 40.0, 30.0), look_at(np.array([-1.5, -2.2, 1.6]), CUBE, UP))
    parts = [Part(RayCaster(rest), np.eye(4), mesh), Part(RayCaster(piece), pose, mesh)]
    found = merge_gbuffers([part.gbuffer(camera) for part in parts])
    expected = RayCaster(trimesh.Trimesh(whole.vertices, whole.faces, process=False)).gbuffer(camera)
    same = np.isclose(found.depth, expected.depth, atol=1e-4)
    assert same.mean() > 0.995, "but for rays along silhouettes"
    np.testing.assert_allclose(np.asarray(found.position)[same], np.asarray(expected.position)[same], atol=1e-3)
