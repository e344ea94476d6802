"""Meshes in and out: what is kept, what is refused, what repair does."""

import base64
import json
import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import refusals
import trimesh

from hyjax.geometry.mesh import degenerate_faces, load_mesh, save_mesh
from hyjax.util.errors import InputError

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"


@pytest.fixture
def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(2, radius=0.5)


def refuses(path: Path, *parts: str, repair: bool = False) -> None:
    refusals.refuses(lambda: load_mesh(path, repair), path.name, *parts)


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


def gltf(nodes: list[dict[str, Any]], roots: list[int], faces: int = 2, uri: str | None = None) -> bytes:
    """A strip of triangles in these nodes; its numbers in a file beside it, if it has a name."""
    vertices = np.random.default_rng(0).random((faces + 2, 3)).astype("<f4")
    corners = (np.arange(faces)[:, None] + np.arange(3)).astype("<u4")
    content = vertices.tobytes() + corners.tobytes()
    buffer = uri or f"data:application/octet-stream;base64,{base64.b64encode(content).decode()}"
    views = [(0, vertices.nbytes), (vertices.nbytes, corners.nbytes)]
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(content), "uri": buffer}],
        "bufferViews": [{"buffer": 0, "byteOffset": start, "byteLength": size} for start, size in views],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": corners.size, "type": "SCALAR"},
        ],
    }
    return json.dumps(tree).encode()


def nested(depth: int) -> list[dict[str, Any]]:
    return [{"children": [k + 1]} for k in range(depth - 1)] + [{"mesh": 0}]


def test_small_files_that_ask_for_much(tmp_path: Path) -> None:
    """A mesh placed many times, and nodes whose reading takes hours."""
    file = tmp_path / "room.gltf"
    twice = [{"mesh": 0}, {"mesh": 0, "translation": [2.0, 0.0, 0.0]}]
    for nodes, roots, count in ((twice, [0, 1], 4), (nested(60), [0], 2)):
        file.write_bytes(gltf(nodes, roots))
        assert len(load_mesh(file).faces) == count
    copies: list[dict[str, Any]] = [{"mesh": 0}] * 600
    for nodes, roots, faces, reason in (
        (nested(3000), [0], 2, r"nested over 64 deep$"),
        ([{"children": [2]}, {"children": [2]}, {"mesh": 0}], [0, 1], 2, r"a node lies in more than one other"),
        (copies, list(range(600)), 2000, r"parts are placed 600 times, with 4793198 vertices and corners that"),
        ([{"mesh": 0}] * 70_000, [0], 2, r"has 70000 nodes; at most 65536 are read$"),
    ):
        file.write_bytes(gltf(nodes, roots, faces))
        with pytest.raises(InputError, match=reason):
            load_mesh(file)


ROW = {"bufferView": 0, "componentType": 5126, "count": 2002, "type": "VEC3"}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda tree: tree.update(meshes=tree["meshes"] * 600), r"its 600 parts are placed 1 times"),
        (lambda tree: tree["meshes"][0].update(primitives=tree["meshes"][0]["primitives"] * 600), r"its 600 parts"),
        (lambda tree: tree.update(bufferViews=tree["bufferViews"] * 600), r"it reads 27 MiB out of far less"),
        (lambda tree: tree.update(accessors=[*tree["accessors"], *[ROW] * 2000]), r"it reads 46 MiB out of"),
        (lambda tree: tree["accessors"].append({**ROW, "count": 10**9}), r"it reads 11444 MiB out of far less"),
        (lambda tree: tree["accessors"][0].pop("bufferView"), r"is compressed \(Draco\) or sparse"),
        (lambda tree: tree["accessors"][0].update(count=10**9), r"it reads 11444 MiB out of far less"),
    ],
)
def test_small_files_that_read_the_same_bytes_again_and_again(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], reason: str
) -> None:
    """A GLB of 100 KiB took 4 GiB, one without numbers 7 GiB: counted before anything is read."""
    file, tree = tmp_path / "room.gltf", json.loads(gltf([{"mesh": 0}], [0], 2000))
    change(tree)
    file.write_text(json.dumps(tree))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=reason):
            load_mesh(file)
        assert tracemalloc.get_traced_memory()[1] < 1 << 23
    finally:
        tracemalloc.stop()


def test_of_a_gltf_nothing_but_surfaces_is_read(tmp_path: Path) -> None:
    """Pictures, notes of meshes and a buffer that is named a thousand times take nothing."""
    (tmp_path / "a.bin").write_bytes(base64.b64decode(json.loads(gltf([], []))["buffers"][0]["uri"][37:]))
    tree = json.loads(gltf([{"mesh": 0, "camera": 0}], [0], uri="a.bin"))
    tree["buffers"] *= 1000
    tree |= {"images": [{"uri": "nowhere.png"}], "materials": [{}], "textures": [{"source": 0}]}
    tree["meshes"][0]["extras"] = {str(key): key for key in range(10)}
    (tmp_path / "room.gltf").write_text(json.dumps(tree))
    assert len(load_mesh(tmp_path / "room.gltf").faces) == 2


def test_the_header_of_a_glb_is_read_without_its_buffers(tmp_path: Path) -> None:
    file, tree = tmp_path / "room.glb", gltf(nested(100), [0])
    start = struct.pack("<4s3I4s", b"glTF", 2, 1 << 28, len(tree), b"JSON")
    file.write_bytes(start + tree)
    os.truncate(file, 1 << 28)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="nested over 64 deep"):
            load_mesh(file)
        assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("uri", ["pipe", "../outside.bin", "/proc/self/mem", "inside.bin"])
def test_files_that_a_mesh_names_are_regular_ones_beside_it(tmp_path: Path, uri: str) -> None:
    """None other is opened: a pipe would never end."""
    folder = tmp_path / "capture"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    whole = json.loads(gltf([{"mesh": 0}], [0]))["buffers"][0]["uri"].partition("base64,")[2]
    for place in (tmp_path / "outside.bin", folder / "inside.bin"):
        place.write_bytes(base64.b64decode(whole))
    (folder / "room.gltf").write_bytes(gltf([{"mesh": 0}], [0], uri=uri))
    (folder / "room.obj").write_text("mtllib pipe\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert len(load_mesh(folder / "room.obj").faces) == 1
    if uri == "inside.bin":
        assert len(load_mesh(folder / "room.gltf").faces) == 2
        return
    with pytest.raises(InputError, match=r"room\.gltf|pipe"):
        load_mesh(folder / "room.gltf")
    with pytest.raises(InputError, match=r"room\.gltf: names a file, .* which is not read from an archive"):
        load_mesh(folder / "room.gltf", content=(folder / "room.gltf").read_bytes())


def test_a_file_that_a_mesh_names_by_many_names_is_read_once(tmp_path: Path) -> None:
    """A thousand names of a small file took as much memory as a thousand files."""
    tree = json.loads(gltf([{"mesh": 0}], [0]))
    (tmp_path / "a.bin").write_bytes(
        base64.b64decode(tree["buffers"][0]["uri"].partition("base64,")[2]) + bytes(1 << 20)
    )
    more = [{"uri": f"{k}/../a.bin", "byteLength": 1 << 20} for k in range(200)]
    tree["buffers"] = [tree["buffers"][0] | {"uri": "a.bin"}, *more]
    (tmp_path / "room.gltf").write_text(json.dumps(tree))
    tracemalloc.start()
    try:
        assert len(load_mesh(tmp_path / "room.gltf").faces) == 2
        assert tracemalloc.get_traced_memory()[1] < 1 << 25
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("choice", ["usemtl {}\n", "usemtl {}\r\n", "use\\\nmtl {}\n", "use\\\r\r\nmtl {}\n"])
def test_an_obj_of_many_materials_is_one_part(tmp_path: Path, choice: str) -> None:
    """trimesh went through all vertices for each material."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    (tmp_path / "a.obj").write_bytes((corners + "".join(choice.format(k) + "f 1 2 3\n" for k in range(9))).encode())
    mesh = load_mesh(tmp_path / "a.obj")
    assert len(mesh.faces) == 9 and len(mesh.vertices) == 3
