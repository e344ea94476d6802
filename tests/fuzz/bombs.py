"""Small files that ask for much, by reader: counts that a file does not hold, the same thing a thousand times."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
from PIL import Image

HUGE = 2_000_000_000
SIDE = 60_000
MEMO = b"\x80\x02Nr" + struct.pack("<I", 0x7FFFFFF0) + b"."
"""A pickle of nothing, whose memo has two thousand million entries."""
JSON_READERS = (
    "schedule",
    "configuration",
    "device latency",
    "tour plan",
    "lights",
    "photo sources",
)
CAPTURES = ("3D Scanner App", "nerfstudio", "Record3D", "Polycam")


def bombs(reader: str) -> tuple[tuple[str, bytes], ...]:
    """(end of the name, content) of the files; none for many readers."""
    return _made(MAKERS[reader]) if reader in MAKERS else ()


@cache
def _made(make: "Callable[[], Bombs]") -> tuple[tuple[str, bytes], ...]:
    return tuple(make())


Bombs = Iterator[tuple[str, bytes]]


def _chunk(kind: bytes, value: bytes) -> bytes:
    return struct.pack(">I", len(value)) + kind + value + struct.pack(">I", zlib.crc32(kind + value))


def _png(width: int, height: int, rows: int) -> bytes:
    """A grey picture of so many rows of zeros, whatever its header says."""
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(width + 1)) for _ in range(rows)) + packer.flush()
    header = _chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _pngs() -> Bombs:
    yield ".png", _png(20_000, 20_000, 2_000)
    yield ".png", _png(SIDE, SIDE, 10)
    yield ".png", _png(HUGE, HUGE, 0)
    header = _chunk(b"IHDR", struct.pack(">2I5B", 4, 4, 8, 0, 0, 0, 0))
    note = _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(1 << 25), 9))
    yield ".png", b"\x89PNG\r\n\x1a\n" + header + note * 20 + _png(4, 4, 4)[33:]


def _pnms() -> Bombs:
    yield ".ppm", b"P6\n60000 60000\n255\n"
    yield ".ppm", b"P3\n2000000000 2000000000 65535\n0 0 0\n"


def _picture(suffix: str, **options: Any) -> Callable[[], Bombs]:
    """A picture of one colour, as large as the format packs into a few hundred KiB."""

    def make() -> Bombs:
        stream = io.BytesIO()
        Image.new("L", (10_000, 10_000)).save(stream, **options)
        yield suffix, stream.getvalue()

    return make


def _json() -> Bombs:
    yield ".json", b"[" + b"[]," * 150_000 + b"[]]"
    yield ".json", b"{" + b",".join(b'"%x":{}' % k for k in range(100_000)) + b"}"
    yield ".json", b'{"a":' * 60 + b"[" + b"1," * 150_000 + b"1]" + b"}" * 60
    yield ".json", b'["' + "\U0001f600".encode() + b"a" * 1_000_000 + b'"]'


def _yaml() -> Bombs:
    yield from _json()
    aliases = b"".join(b"a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 12))
    yield ".yaml", b"a0: &a0 [1, 2]\n" + aliases
    yield ".yaml", b"- " * 60 + b"[" + b"1, " * 40_000 + b"1]"


def _tree(faces: int) -> tuple[dict[str, Any], bytes]:
    """A glTF of one strip of triangles, and its numbers."""
    vertices = np.random.default_rng(0).random((faces + 2, 3)).astype("<f4")
    corners = (np.arange(faces)[:, None] + np.arange(3)).astype("<u4")
    sizes = (0, vertices.nbytes), (vertices.nbytes, corners.nbytes)
    entries = (5126, len(vertices), "VEC3"), (5125, corners.size, "SCALAR")
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": vertices.nbytes + corners.nbytes}],
        "bufferViews": [{"buffer": 0, "byteOffset": start, "byteLength": size} for start, size in sizes],
        "accessors": [
            {"bufferView": k, "componentType": kind, "count": count, "type": shape}
            for k, (kind, count, shape) in enumerate(entries)
        ],
    }
    return tree, vertices.tobytes() + corners.tobytes()


def _glb(change: Callable[[dict[str, Any]], Any], faces: int = 4000) -> tuple[str, bytes]:
    tree, numbers = _tree(faces)
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    size = 28 + len(text) + len(numbers)
    start = b"glTF" + struct.pack("<2I", 2, size) + struct.pack("<I", len(text)) + b"JSON" + text
    return ".glb", start + struct.pack("<I", len(numbers)) + b"BIN\0" + numbers


def _nested(tree: dict[str, Any], deep: int, often: int) -> None:
    nodes: list[dict[str, Any]] = []
    for _ in range(often):
        nodes += [{"children": [len(nodes) + k + 1]} for k in range(deep)] + [{"mesh": 0}]
    tree.update(nodes=nodes, scenes=[{"nodes": list(range(0, len(nodes), deep + 1))}])


def _instances(tree: dict[str, Any], count: int) -> None:
    tree.update(nodes=[{"mesh": 0}] * count, scenes=[{"nodes": list(range(count))}])


def _ply(form: str, vertices: int, faces: int, content: bytes) -> tuple[str, bytes]:
    coordinates = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat {form} 1.0\nelement vertex {vertices}\n{coordinates}element face {faces}\n"
    return ".ply", f"{header}property list uint int vertex_indices\nend_header\n".encode() + content


def _meshes() -> Bombs:
    yield _glb(lambda tree: _instances(tree, 1000))
    yield _glb(lambda tree: _instances(tree, 10_000), 1)
    yield _glb(lambda tree: tree.update(meshes=tree["meshes"] * 3000))
    yield _glb(lambda tree: tree["meshes"][0].update(primitives=tree["meshes"][0]["primitives"] * 3000))
    yield _glb(lambda tree: tree["accessors"].append({"componentType": 5126, "count": HUGE, "type": "MAT4"}))
    yield _glb(lambda tree: tree["accessors"][0].pop("bufferView"))
    yield _glb(lambda tree: tree.update(bufferViews=tree["bufferViews"] * 10_000))
    yield _glb(lambda tree: tree["bufferViews"][0].update(byteStride=1))
    yield _glb(lambda tree: _nested(tree, 60, 200), 1)
    yield _glb(lambda tree: _nested(tree, 5000, 1), 1)
    yield _glb(lambda tree: tree["meshes"][0].update(extras={str(k): k for k in range(50_000)}))
    for form in ("ascii", "binary_little_endian"):
        yield _ply(form, HUGE, HUGE, b"0 0 0\n")
        yield _ply(form, 3, 1, bytes(36) + struct.pack("<I", 0x7FFFFFFF))
    yield ".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 100_000 + b"\n"
    yield (
        ".obj",
        b"mtllib nowhere\nv 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"usemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\n" * 10_000,
    )


def _tensors() -> Bombs:
    entry = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    text = json.dumps({f"{k}": entry for k in range(100_000)}).encode()
    yield ".safetensors", struct.pack("<Q", len(text)) + text
    for shape, end in ([HUGE, HUGE], 0), ([HUGE], 4 * HUGE):
        text = json.dumps({"a": {"dtype": "F32", "shape": shape, "data_offsets": [0, end]}}).encode()
        yield ".safetensors", struct.pack("<Q", len(text)) + text
    yield ".safetensors", MEMO
    yield ".safetensors", struct.pack("<Q", 1 << 62) + b"{}"


def _zip(files: dict[str, bytes], size: int | None = None) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    packed = stream.getvalue()
    return packed if size is None else packed.replace(struct.pack("<I", len(content)), struct.pack("<I", size))


def _archives() -> Bombs:
    yield "", _zip({"scan/info.json": bytes(64 << 20)})
    yield "", _zip({"scan/info.json": bytes(1 << 20)}, 0x7FFFFFFF)
    yield "", _zip({"scan/info.json": bytes(64 << 20)}, 4096)
    yield "", _zip({f"scan/{k}": b"" for k in range(20_000)})
    yield "", _zip({"scan/a.zip": _zip({"a": bytes(64 << 20)})})


MAKERS: dict[str, Callable[[], Bombs]] = {
    "png": _pngs,
    "depth map": _pngs,
    "labels": _pngs,
    "pnm": _pnms,
    "jpeg": _picture(".jpg", format="JPEG"),
    "tiff": _picture(".tif", format="TIFF", compression="tiff_lzw"),
    "mesh": _meshes,
    "safetensors": _tensors,
    "ZIP archive": _archives,
    "Record3D archive": _archives,
    **dict.fromkeys(JSON_READERS, _yaml),
    **dict.fromkeys(CAPTURES, _json),
}
"""By reader; the others have no format of counts, or lie in one of these."""
