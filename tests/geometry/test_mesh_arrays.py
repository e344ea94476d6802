"""Arrays of a mesh against trimesh, stored and read again."""

import numpy as np
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from hyjax.geometry.mesh_arrays import MeshArrays


@st.composite
def meshes(draw: st.DrawFn) -> trimesh.Trimesh:
    """Loose triangles in single precision, the last vertex used by none."""
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    vertices = rng.normal(size=(12, 3)).astype(np.float32)
    faces = np.array([rng.choice(11, 3, replace=False) for _ in range(7)])
    return trimesh.Trimesh(vertices, faces, process=False)


@given(meshes())
def test_they_are_what_trimesh_says(mesh: trimesh.Trimesh) -> None:
    arrays = MeshArrays(mesh.vertices, mesh.faces)
    np.testing.assert_array_equal(arrays.bounds, mesh.bounds)
    np.testing.assert_allclose(arrays.face_normals, mesh.face_normals, atol=1e-12)
    np.testing.assert_array_equal(arrays.vertex_normals, mesh.vertex_normals)
    np.testing.assert_array_equal(arrays.mesh.faces, mesh.faces)


@given(meshes())
def test_stored_arrays_are_the_mesh(mesh: trimesh.Trimesh) -> None:
    turned = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=-mesh.vertex_normals, process=False)
    given_ = MeshArrays.of(turned)
    assert given_.mesh is turned and MeshArrays.of(given_) is given_
    found = MeshArrays.stored(given_.to_store())
    assert found.key == given_.key
    for own in (found.vertex_normals, found.mesh.vertex_normals):
        np.testing.assert_allclose(own, turned.vertex_normals, atol=1e-6)


@given(meshes(), st.integers(0, 6), st.integers(0, 10))
def test_the_key_follows_vertices_and_triangles(mesh: trimesh.Trimesh, face: int, vertex: int) -> None:
    moved, wound = np.array(mesh.vertices), np.array(mesh.faces)
    moved[vertex, 1] += 1.0
    wound[face] = wound[face, ::-1]
    parts = [(mesh.vertices, mesh.faces), (moved, mesh.faces), (mesh.vertices, wound)]
    assert len({MeshArrays(*part).key for part in parts}) == 3
