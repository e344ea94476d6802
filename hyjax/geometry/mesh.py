"""Triangle meshes in and out, checked when they are read so that no later code has to."""

import functools
import io
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.ply import export_ply
from trimesh.resolvers import FilePathResolver

from hyjax.geometry.gltf import counted_gltf
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write
from hyjax.util.reading import check_regular, open_regular, read_bytes
from hyjax.util.vectors import SHORTEST_LENGTH, unit

READABLE = (".ply", ".obj", ".glb", ".gltf")
WRITABLE = (".ply", ".glb")
# Twice a triangle's area over its longest edge squared; below this it has no direction to be shaded in.
FLATNESS_TOLERANCE = 1e-10
LARGEST_BUFFER = 1 << 30
"""Bytes of a file that a mesh names."""
CONTINUED_LINE = re.compile(rb"\\\r*\n")
MATERIAL = re.compile(rb"usemtl [^\n]*")
"""Choice of a material in an OBJ."""
_log = logging.getLogger(__name__)


@np.errstate(all="ignore")  # what is not finite is reported below, with its number
def load_mesh(path: Path, repair: bool = False, content: bytes | None = None) -> trimesh.Trimesh:
    """Read a PLY, OBJ, GLB or glTF file as one triangle mesh.

    Coordinates are taken as they are, in metres and in the file's own axes: a glTF that is y-up stays y-up.
    A scene of several parts is put together with their transforms. Vertex normals in the file are kept;
    colours and materials are not. An OBJ or ASCII file cut off exactly between two faces of an uncounted
    list cannot be told from a whole one.

    Args:
        repair: drop unusable faces (and the vertices that only they used) instead of refusing them, with a line
            that counts them.
        content: the file's bytes, where it lies in an archive.
    """
    path = Path(path)
    if path.suffix.lower() not in READABLE:
        raise InputError(f"{path}: unknown mesh format '{path.suffix}'; known are {', '.join(READABLE)}")
    if content is None:
        check_regular(path)
    vertices, faces, normals = _concatenate(list(_parts(path, content)))
    if len(faces) == 0:
        raise InputError(f"{path}: has no faces (truncated, or a point cloud?); need a triangle mesh")
    bad, reason = _unusable_faces(vertices, faces)
    if reason and not repair:
        raise InputError(f"{path}: {reason}; --repair-mesh drops them")
    kept = faces[~bad]
    if len(kept) == 0:
        raise InputError(f"{path}: all {len(faces)} triangles are unusable ({reason}); need a triangle mesh")
    if reason:
        _log.warning("%s: %s; %d of %d faces are dropped", path, reason, bad.sum(), len(faces))
    return _compact(vertices, kept, normals) if repair else _mesh(vertices, kept, normals)


def submesh(mesh: trimesh.Trimesh, chosen: Bool[np.ndarray, "m"]) -> trimesh.Trimesh:
    """The chosen faces of a mesh, with its vertex normals, and no more vertices than they need."""
    return _compact(np.asarray(mesh.vertices), np.asarray(mesh.faces)[chosen], np.asarray(mesh.vertex_normals))


def save_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh with its vertex normals as binary PLY or GLB (float32), by a temporary name and a rename."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in WRITABLE:
        raise InputError(f"{path}: meshes are written as {' or '.join(WRITABLE)}, not '{path.suffix}'")
    data: Any = export_ply(mesh, vertex_normal=True) if kind == ".ply" else export_glb(mesh, include_normals=True)
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)


def degenerate_faces(vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Bool[np.ndarray, "m"]:
    """Mask of the triangles that have no area: a repeated vertex, or corners on one line."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    longest = np.max([np.sum(edge * edge, axis=1) for edge in (b - a, c - b, a - c)], axis=0)
    doubled_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return repeated | (doubled_area <= FLATNESS_TOLERANCE * longest)


Part = tuple[np.ndarray, np.ndarray, np.ndarray | None]


def _parts(path: Path, content: bytes | None) -> Iterator[Part]:
    """(vertices, faces, vertex normals if the file has them) of each mesh in the file, in world axes."""
    try:
        kind = path.suffix[1:].lower()
        options: dict[str, Any] = {"process": False, "skip_materials": True}
        if kind in ("glb", "gltf"):
            # What lies beside a file of an archive is not read.
            beside = _FilesBeside(str(path)).get if content is None else functools.partial(_nothing_beside, path)
            slim, buffers = counted_gltf(path, content, beside)
            scene = trimesh.load_scene(slim, "gltf", resolver=buffers, **options)
        elif kind == "obj":
            with open_regular(path) if content is None else io.BytesIO(content) as file:
                text = CONTINUED_LINE.sub(b"", file.read())
            # Without its materials: trimesh goes through all vertices for each of them.
            scene = trimesh.load_scene(io.BytesIO(MATERIAL.sub(b"#", text)), kind, **options)
        else:
            with path.open("rb") if content is None else io.BytesIO(content) as file:
                scene = trimesh.load_scene(file, kind, **options)
        placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
        parts = [(scene.geometry[name], transform) for transform, name in placed]
        meshes = [(part, transform) for part, transform in parts if isinstance(part, trimesh.Trimesh)]
        for part, transform in meshes:
            yield _transformed(part, transform)
            _check_announced_faces(path, part, content)
    except InputError:
        raise
    except Exception as error:  # each of trimesh's readers fails in its own way: Value-, Index-, KeyError, ...
        raise InputError(
            f"{path}: cannot be read as a mesh, damaged or truncated? ({type(error).__name__}: {error})"
        ) from error


class _FilesBeside(FilePathResolver):
    """Files that a mesh names: regular ones in its own folder, of bounded size; each is read once."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self._read: dict[Path, bytes] = {}

    def get(self, name: str) -> bytes:
        path = self.absolute(name)  # `a.bin`, `./a.bin` and `x/../a.bin` are one
        if path not in self._read:
            self._read[path] = read_bytes(path, most=LARGEST_BUFFER)
        return self._read[path]


def _nothing_beside(path: Path, name: str) -> bytes:
    raise InputError(f"{path}: names a file, {name[:60]!r}, which is not read from an archive; unpack it")


def _transformed(part: trimesh.Trimesh, transform: Float[np.ndarray, "4 4"]) -> Part:
    linear = transform[:3, :3]
    vertices = np.asarray(part.vertices) @ linear.T + transform[:3, 3]
    faces = np.asarray(part.faces, dtype=np.int64).reshape(-1, 3)
    # A mirroring transform turns triangles inside out; wind them back.
    if np.linalg.det(linear) < 0:
        faces = faces[:, ::-1]
    # Asking for `vertex_normals` would compute them; only those that came with the file are in the cache.
    if "vertex_normals" not in part._cache:
        return vertices, faces, None
    normals = np.asarray(part.vertex_normals) @ np.linalg.inv(linear)
    if not np.isfinite(normals).all():
        return vertices, faces, None
    return vertices, faces, unit(normals, SHORTEST_LENGTH)


def _check_announced_faces(path: Path, part: trimesh.Trimesh, content: bytes | None) -> None:
    """An ASCII PLY cut off in its face list is read without complaint; its header knows better."""
    if path.suffix.lower() != ".ply":
        return
    with path.open("rb") if content is None else io.BytesIO(content) as file:
        header = file.read(65536).partition(b"end_header")[0]
    for line in header.splitlines():
        words = line.split()
        if words[:2] == [b"element", b"face"] and int(words[2]) > len(part.faces):
            raise InputError(f"{path}: truncated, has {len(part.faces)} of {int(words[2])} faces")


def _concatenate(parts: list[Part]) -> Part:
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), None
    offsets = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    normals = [part[2] for part in parts if part[2] is not None]
    return (
        np.concatenate([vertices for vertices, _, _ in parts]),
        np.concatenate([faces + offset for (_, faces, _), offset in zip(parts, offsets)]),
        np.concatenate(normals) if len(normals) == len(parts) else None,
    )


def _unusable_faces(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Bool[np.ndarray, "m"], str]:
    """Mask of the faces that cannot be used, and the reason for the first kind of them ('' if there is none)."""
    broken = ~np.isfinite(vertices).all(axis=1)
    stray = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    bad = np.array(stray)
    bad[~stray] = broken[faces[~stray]].any(axis=1)
    flat = np.zeros_like(bad)
    flat[~bad] = degenerate_faces(vertices, faces[~bad])
    if stray.any():
        reason = (
            f"{stray.sum()} faces use vertices beyond the {len(vertices)} there are (first: face {stray.argmax()})"
        )
    elif broken.any():
        reason = f"{broken.sum()} vertices are NaN or infinite (first: vertex {broken.argmax()})"
    elif flat.any():
        reason = f"{flat.sum()} degenerate triangles without area (first: face {flat.argmax()})"
    else:
        reason = ""
    return bad | flat, reason


def _compact(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], normals: Float[np.ndarray, "n 3"] | None
) -> trimesh.Trimesh:
    used, renumbered = np.unique(faces, return_inverse=True)
    return _mesh(vertices[used], renumbered.reshape(-1, 3), None if normals is None else normals[used])


def _mesh(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], normals: Float[np.ndarray, "n 3"] | None
) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)
