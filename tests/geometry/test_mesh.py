"""Meshes in and out: what is kept, what is refused, what repair does."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hyjax.geometry.mesh import degenerate_faces, load_mesh, save_mesh
from hyjax.util.errors import InputError

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"


@pytest.fixture
def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, radius=0.5)


def refuses(path: Path, *parts: str, repair: bool = False) -> None:
    with pytest.raises(InputError) as caught:
        load_mesh(path, repair)
    message = str(caught.value)
    assert "\n" not in message
    for part in (path.name, *parts):
        assert part in message


def write_obj(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_round_trip_keeps_vertices_faces_and_given_normals(
    tmp_path: Path, sphere: trimesh.Trimesh, suffix: str
) -> None:
    given = -np.asarray(sphere.vertices) / 0.5  # inwards, so that recomputed ones would be noticed
    mesh = trimesh.Trimesh(sphere.vertices, sphere.faces, vertex_normals=given, process=False)
    path = tmp_path / f"mesh{suffix}"
    save_mesh(path, mesh)
    back = load_mesh(path)
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_allclose(back.vertex_normals, given, atol=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]  # no temporary file is left


def test_scene_is_concatenated_with_its_transforms(tmp_path: Path, sphere: trimesh.Trimesh) -> None:
    scene = trimesh.Scene()
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirrored[0, 3] = 3.0
    scene.add_geometry(sphere, geom_name="ball")
    scene.add_geometry(sphere, geom_name="mirrored ball", transform=mirrored)
    scene.export(tmp_path / "two.glb")
    mesh = load_mesh(tmp_path / "two.glb")
    assert len(mesh.faces) == 2 * len(sphere.faces)
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -0.5, -0.5], [3.5, 0.5, 0.5]], atol=1e-3)
    # A mirrored part keeps its inside inside.
    assert mesh.volume == pytest.approx(2 * sphere.volume, rel=1e-4)


def test_gltf_axes_are_left_alone(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 2, 3))
    for name, content in trimesh.Scene(box).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    (file,) = tmp_path.glob("*.gltf")
    json.loads(file.read_text())
    np.testing.assert_allclose(load_mesh(file).extents, [1, 2, 3])


@pytest.mark.parametrize("share", [0.97, 0.6, 0.3, 0.05, 0.0])
@pytest.mark.parametrize(("suffix", "encoding"), [(".ply", "binary"), (".ply", "ascii"), (".glb", None)])
def test_truncated_files(
    tmp_path: Path, sphere: trimesh.Trimesh, suffix: str, encoding: str | None, share: float
) -> None:
    options = {"encoding": encoding} if encoding else {}
    data = sphere.export(file_type=suffix[1:], **options)
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(data[: int(len(data) * share)])
    refuses(path)


def test_missing_unknown_and_empty(tmp_path: Path) -> None:
    refuses(tmp_path / "none.ply", "no such file")
    refuses(write_obj(tmp_path / "room.fbx", "x"), ".fbx", ".ply", ".glb")
    refuses(write_obj(tmp_path / "points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no faces")
    refuses(write_obj(tmp_path / "void.obj", ""), "no faces")
    refuses(write_obj(tmp_path / "text.ply", "hello\n"), "cannot be read")


def test_nan_vertex_is_counted_and_named(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "nan.obj", SQUARE + "v nan 0 0\nv inf 0 0\nf 1 2 5\nf 2 6 3\n")
    refuses(path, "2 vertices", "vertex 4", "--repair-mesh")
    repaired = load_mesh(path, repair=True)
    assert (len(repaired.vertices), len(repaired.faces)) == (4, 2)


def test_face_indices_out_of_range(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    path = write_obj(tmp_path / "stray.ply", header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 7\n")
    refuses(path, "1 faces", "face 1", "--repair-mesh")
    assert len(load_mesh(path, repair=True).faces) == 1


@pytest.mark.parametrize("extra", ["f 2 3 3\n", "v 0.5 0 0\nf 1 5 2\n"], ids=["repeated", "collinear"])
def test_degenerate_triangles(tmp_path: Path, extra: str) -> None:
    path = write_obj(tmp_path / "flat.obj", SQUARE + extra)
    refuses(path, "1 degenerate", "face 2", "--repair-mesh")
    repaired = load_mesh(path, repair=True)
    assert (len(repaired.vertices), len(repaired.faces)) == (4, 2)


def test_repair_cannot_make_something_of_nothing(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    refuses(path, "all 1 triangles", repair=True)


def test_thin_is_not_degenerate() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]])
    assert not degenerate_faces(vertices, np.array([[0, 1, 2]])).any()


def test_saving_where_it_cannot_be(tmp_path: Path, sphere: trimesh.Trimesh) -> None:
    with pytest.raises(InputError, match=r"mesh\.stl.*\.ply or \.glb"):
        save_mesh(tmp_path / "mesh.stl", sphere)
    with pytest.raises(InputError, match=r"nowhere.*cannot write"):
        save_mesh(tmp_path / "nowhere" / "mesh.ply", sphere)
