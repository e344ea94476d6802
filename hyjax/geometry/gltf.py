"""glTF and GLB files, whose sizes are counted and which are cut down to surfaces before trimesh reads them.

A mesh may be placed many times, and many views and accessors may read the same bytes, so that a small file asks for
gigabytes. Materials, pictures, names, cameras and what extensions add are left out.
"""

import base64
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from hyjax.util.errors import InputError
from hyjax.util.reading import LARGEST_JSON, check_most, open_regular, parse_json

DEEPEST_NODE = 64
"""Largest number of transforms in turn of a node; the time that trimesh takes grows with its cube."""
MOST_PARTS = 1 << 16
"""Largest number of nodes, of primitives, and of primitives that nodes place; reading so many takes two seconds."""
MOST_ACCESSORS = 1 << 18
"""Largest number of accessors, and of views of buffers."""
MOST_COPIES = 4_000_000
"""Largest number of vertices and corners that come of reading others again: those of a million faces."""
MOST_READINGS = 4
"""Times that all bytes of the buffers may be read."""
HARMLESS_BYTES = 1 << 24
"""Bytes that may be read in any case."""
BINARY_CHUNK = b"BIN\0"
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2}
"""Bytes of a number by its kind; others have four."""
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9}
"""Numbers of an entry by its type; others have sixteen."""
NODE = ("children", "mesh", "matrix", "translation", "rotation", "scale")
ACCESSOR = ("bufferView", "byteOffset", "componentType", "count", "type")
VIEW = ("buffer", "byteOffset", "byteLength", "byteStride")
ATTRIBUTES = ("POSITION", "NORMAL")


def counted_gltf(
    path: Path, content: bytes | None, beside: Callable[[str], bytes]
) -> tuple[BinaryIO, Mapping[str, bytes]]:
    """A glTF of nothing but surfaces, and the buffers that it names.

    Args:
        content: the file's bytes, where it lies in an archive.
    """
    with open_regular(path) if content is None else io.BytesIO(content) as file:
        tree, is_binary = _header(path, file)
        nodes, scenes = tree.get("nodes", []), tree.get("scenes", [])
        meshes = [_primitives(mesh) for mesh in tree.get("meshes", [])]
        accessors, views = tree.get("accessors", []), tree.get("bufferViews", [])
        _check_nodes(path, nodes)
        _check_parts(path, nodes, meshes, accessors, views)
        _check_copies(path, nodes, meshes, accessors)
        buffers = _buffers(path, tree.get("buffers", []), file if is_binary else None, beside)
    sizes = (SIZES.get(a["componentType"], 4) * COLUMNS.get(a["type"], 16) * max(a["count"], 0) for a in accessors)
    read = max(sum(sizes), sum(max(view["byteLength"], 0) for view in views))
    if read > HARMLESS_BYTES + MOST_READINGS * sum(map(len, {id(buffer): buffer for buffer in buffers}.values())):
        raise InputError(f"{path}: refused, it reads {read / 2**20:.0f} MiB out of far less")
    roots = scenes[tree.get("scene", 0)].get("nodes", []) if scenes else []
    slim = {
        "asset": {"version": tree.get("asset", {}).get("version", "2.0")},
        "scenes": [{"nodes": list(dict.fromkeys(roots))}],
        "nodes": _only(nodes, NODE),
        "meshes": [{"primitives": primitives} for primitives in meshes],
        "accessors": _only(accessors, ACCESSOR),
        "bufferViews": _only(views, VIEW),
        "buffers": [{"uri": str(number)} for number in range(len(buffers))],
    }
    named = {str(number): buffer for number, buffer in enumerate(buffers)}
    return io.BytesIO(json.dumps(slim).encode()), named


def _only(entries: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[dict[str, Any]]:
    return [{key: entry[key] for key in keys if key in entry} for entry in entries]


def _header(path: Path, file: BinaryIO) -> tuple[Any, bool]:
    """The JSON of a glTF or of a GLB, whose buffers stay unread, and whether it is a GLB."""
    start = file.read(20)
    is_binary = start.startswith(b"glTF")
    if is_binary:
        version, size = (int.from_bytes(start[at : at + 4], "little") for at in (4, 12))
        if version != 2 or start[16:] != b"JSON":
            raise InputError(f"{path}: not a GLB of version 2")
        check_most(size, LARGEST_JSON, str(path))
        text = file.read(size)
    else:
        check_most(file.seek(0, io.SEEK_END), LARGEST_JSON, str(path))
        file.seek(0)
        text = file.read()
    return parse_json(text, str(path)), is_binary


def _primitives(mesh: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Primitives of a mesh: their positions, normals and corners."""
    return [
        {"attributes": {name: entry["attributes"][name] for name in ATTRIBUTES if name in entry["attributes"]}}
        | {key: entry[key] for key in ("indices", "mode") if key in entry}
        for entry in mesh["primitives"]
    ]


def _check_nodes(path: Path, nodes: Sequence[Mapping[str, Any]]) -> None:
    """Raise `InputError` for nodes that are nested too deep, or in more than one other."""
    parents = {child: parent for parent, node in enumerate(nodes) for child in node.get("children", [])}
    if len(parents) < sum(len(node.get("children", [])) for node in nodes):
        raise InputError(f"{path}: a node lies in more than one other, which glTF does not allow")
    for node in parents:
        depth = 1
        while (node := parents.get(node)) is not None and depth <= DEEPEST_NODE:
            depth += 1
        if depth > DEEPEST_NODE:
            raise InputError(f"{path}: its nodes are nested over {DEEPEST_NODE} deep")


def _check_parts(
    path: Path,
    nodes: Sequence[Any],
    meshes: Sequence[Sequence[Any]],
    accessors: Sequence[Any],
    views: Sequence[Any],
) -> None:
    placed = sum(len(meshes[node["mesh"]]) for node in nodes if "mesh" in node)
    for count, what, most in (
        (len(nodes), "nodes", MOST_PARTS),
        (sum(map(len, meshes)) + len(meshes), "parts of meshes", MOST_PARTS),
        (placed, "places of meshes", MOST_PARTS),
        (len(accessors) + len(views), "arrays", MOST_ACCESSORS),
    ):
        if count > most:
            raise InputError(f"{path}: has {count} {what}; at most {most} are read")


def _check_copies(
    path: Path,
    nodes: Sequence[Mapping[str, Any]],
    meshes: Sequence[Sequence[Mapping[str, Any]]],
    accessors: Sequence[Mapping[str, Any]],
) -> None:
    """Raise `InputError` for arrays without numbers, or for the same numbers in far too many surfaces."""
    once: set[int] = set()
    sizes = []
    for primitives in meshes:
        used = [each for entry in primitives for each in entry["attributes"].values()]
        used += [entry["indices"] for entry in primitives if "indices" in entry]
        if any("bufferView" not in accessors[each] for each in used):
            raise InputError(f"{path}: its surface is compressed (Draco) or sparse; export it without")
        sizes.append(sum(max(accessors[each]["count"], 0) for each in used))
        once.update(used)
    places = [node["mesh"] for node in nodes if "mesh" in node]
    stored = sum(max(accessors[each]["count"], 0) for each in once)
    copies = max(sum(sizes), sum(sizes[mesh] for mesh in places)) - stored
    if copies > MOST_COPIES:
        raise InputError(
            f"{path}: refused, its {sum(map(len, meshes))} parts are placed {len(places)} times, "
            f"with {copies} vertices and corners that others have too; at most {MOST_COPIES} are read"
        )


def _buffers(
    path: Path, entries: Sequence[Mapping[str, Any]], binary: BinaryIO | None, beside: Callable[[str], bytes]
) -> list[bytes]:
    """Content of each buffer, from the GLB, from base64 text or from another file, each of which is read once."""
    found: dict[str | None, bytes] = {}
    for entry in entries:
        uri = entry.get("uri")
        if uri in found:
            continue
        if uri is None:
            found[uri] = _binary_chunk(path, binary)
        elif "base64," in uri:
            found[uri] = base64.b64decode(uri.partition("base64,")[2])
        else:
            found[uri] = beside(uri)
    return [found[entry.get("uri")] for entry in entries]


def _binary_chunk(path: Path, file: BinaryIO | None) -> bytes:
    """The next chunk of numbers of a GLB."""
    while file is not None and len(start := file.read(8)) == 8:
        size = int.from_bytes(start[:4], "little")
        content = file.read(size)
        if start[4:] == BINARY_CHUNK and len(content) == size:
            return content
    raise InputError(f"{path}: damaged or truncated, it has no numbers")
