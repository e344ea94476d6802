"""Small files that ask for much, by reader: counts that a file does not hold, the same thing a thousand times."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from .picture_bombs import HUGE, Bombs, bmps, exrs, of_one_colour, pfms, pngs, pnms, tiffs, webps

MEMO = b"\x80\x02Nr" + struct.pack("<I", 0x7FFFFFF0) + b"."
"""A pickle of nothing, whose memo has two thousand million entries."""
JSON_READERS = (
    "schedule",
    "configuration",
    "sweep spec",
    "device latency",
    "tour plan",
    "lights",
    "photo sources",
)
LINE_READERS = ("run log", "results", "training run", "study", "kept trials", "sweep rows")
CAPTURES = ("3D Scanner App", "nerfstudio", "Record3D", "Polycam")


def bombs(reader: str) -> tuple[tuple[str, bytes], ...]:
    """(end of the name, content) of the files; none for many readers."""
    return _made(MAKERS[reader]) if reader in MAKERS else ()


@cache
def _made(make: "Callable[[], Bombs]") -> tuple[tuple[str, bytes], ...]:
    return tuple(make())


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


def _lines() -> Bombs:
    yield ".jsonl", b'{"k": 1, "key": "1", "a": [' + b"[]," * 300_000 + b"[]]}\n"
    yield ".jsonl", b'{"k": 1, "key": "1"}\n' * 40_000


def _live() -> Bombs:
    start = b'{"kind": "hyjax-live-1"'
    yield ".bin", start + b" " * 1_000_000
    yield ".bin", start + b', "picture_bytes": 67108864, "depth_bytes": 67108864}\n'
    yield ".bin", start + b', "pose": ' + b"[" * 50 + b"[]," * 5000 + b"[]" + b"]" * 50 + b"}\n"


def _device_messages() -> Bombs:
    yield ".json", b'{"job": 1, "milliseconds": [' + b"1," * 500_000 + b'1], "last": false}'
    yield from _json()


def _colmap_maps() -> Bombs:
    yield ".bin", b"65536&65536&1&"
    yield ".bin", b"1&1&1&" + bytes(1 << 20)


def _colmap_models() -> Bombs:
    point = struct.pack("<3d3BdQ", 0.0, 0.0, 1.0, 1, 1, 1, 0.1, 0)
    for count in 1 << 63, 1 << 32, 20_000:
        points = b"".join(struct.pack("<Q", k) + point for k in range(20_000))
        yield "points3D.bin", struct.pack("<Q", count) + points
        yield "images.bin", struct.pack("<Q", count) + bytes(1 << 20)
        yield "cameras.bin", struct.pack("<Q", count) + bytes(1 << 20)


def _sens() -> Bombs:
    """Packed depth maps of nothing, frames without pictures, and more of them than there are."""
    camera = np.array([[50, 0, 32, 0], [0, 50, 24, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "<f4").tobytes()
    pose = np.eye(4, dtype="<f4").tobytes()
    packer = zlib.compressobj(9)
    depth = b"".join(packer.compress(bytes(1 << 20)) for _ in range(512)) + packer.flush()
    start = struct.pack("<IQ", 4, 0) + camera + pose + camera + pose
    for side, count in (16_384, 1), (4096, 1), (64, 1 << 63):
        head = start + struct.pack("<2i4IfQ", 2, 1, 64, 48, side, side, 1000.0, count)
        yield ".sens", head + pose + struct.pack("<4Q", 0, 0, 0, len(depth)) + depth
    frame = pose + struct.pack("<4Q", 0, 0, 0, 0)
    yield ".sens", start + struct.pack("<2i4IfQ", 2, 1, 64, 48, 64, 48, 1000.0, HUGE) + frame * 5000


def _boxes(*kinds: bytes, content: bytes) -> bytes:
    for kind in reversed(kinds):
        content = struct.pack(">I4s", 8 + len(content), kind) + content
    return content


def _videos() -> Bombs:
    """Tables that count pictures which are not there."""
    start = _boxes(b"ftyp", content=b"isom" + bytes(4))
    handler = _boxes(b"hdlr", content=bytes(8) + b"vide" + bytes(13))
    clock = _boxes(b"mdhd", content=bytes(12) + struct.pack(">2I", 30, 0) + bytes(4))
    sides = struct.pack(">2H", 64, 48)
    format_ = _boxes(b"avc1", content=bytes(6) + struct.pack(">H", 1) + bytes(16) + sides + bytes(50))
    tables = _boxes(b"stsd", content=struct.pack(">2I", 0, 1) + format_)
    for count in 60_000_000, 0x7FFFFFFF:
        counted = tables + _boxes(b"stsz", content=struct.pack(">3I", 0, 1, count))
        counted += _boxes(b"stts", content=struct.pack(">4I", 0, 1, count, 1))
        counted += _boxes(b"stsc", content=struct.pack(">5I", 0, 1, 1, count, 1))
        counted += _boxes(b"stco", content=struct.pack(">3I", 0, 1, 32))
        media = clock + handler + _boxes(b"minf", b"stbl", content=counted)
        yield ".mp4", start + _boxes(b"mdat", content=bytes(100)) + _boxes(b"moov", b"trak", b"mdia", content=media)


def _nyu() -> Bombs:
    import h5py

    pieces = {"single": (1, 1), "whole": (1 << 11, 1 << 11)}
    for piece in pieces.values():
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            for name, more, kind in ("images", (3,), "u1"), ("depths", (), "f8"), ("rawDepths", (), "f8"):
                shape = (1 << 40, *more, 1 << 11, 1 << 11)
                file.create_dataset(name, shape, kind, chunks=(1, *([1] * len(more)), *piece), compression="gzip")
        yield ".mat", stream.getvalue()


MAKERS: dict[str, Callable[[], Bombs]] = {
    "png": pngs,
    "depth map": pngs,
    "labels": pngs,
    "pnm": pnms,
    "jpeg": of_one_colour(".jpg", format="JPEG"),
    "tiff": tiffs,
    "exr": exrs,
    "webp": webps,
    "bmp": bmps,
    "Middlebury 2014": pfms,
    "COLMAP depth": _colmap_maps,
    "COLMAP binary": _colmap_models,
    "ScanNet": _sens,
    "video": _videos,
    "NYU": _nyu,
    "live messages": _live,
    "device message": _device_messages,
    "web page": _json,
    "mesh": _meshes,
    "safetensors": _tensors,
    "ZIP archive": _archives,
    "Record3D archive": _archives,
    **dict.fromkeys(JSON_READERS, _yaml),
    **dict.fromkeys(LINE_READERS, _lines),
    **dict.fromkeys(CAPTURES, _json),
}
"""By reader; the others have no format of counts, or lie in one of these."""
