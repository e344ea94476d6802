"""Small pictures that ask for much: sizes, tiles and colours that they lack, or pixels that pack to nothing."""

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any

from PIL import Image

HUGE = 2_000_000_000
SIDE = 60_000
Bombs = Iterator[tuple[str, bytes]]


def _chunk(kind: bytes, value: bytes) -> bytes:
    return struct.pack(">I", len(value)) + kind + value + struct.pack(">I", zlib.crc32(kind + value))


def _png(width: int, height: int, rows: int) -> bytes:
    """A grey picture of so many rows of zeros, whatever its header says."""
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(width + 1)) for _ in range(rows)) + packer.flush()
    header = _chunk(b"IHDR", struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def pngs() -> Bombs:
    yield ".png", _png(20_000, 20_000, 2_000)
    yield ".png", _png(SIDE, SIDE, 10)
    yield ".png", _png(HUGE, HUGE, 0)
    header = _chunk(b"IHDR", struct.pack(">2I5B", 4, 4, 8, 0, 0, 0, 0))
    note = _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(1 << 25), 9))
    yield ".png", b"\x89PNG\r\n\x1a\n" + header + note * 20 + _png(4, 4, 4)[33:]


def pnms() -> Bombs:
    yield ".ppm", b"P6\n60000 60000\n255\n"
    yield ".ppm", b"P3\n2000000000 2000000000 65535\n0 0 0\n"


def of_one_colour(suffix: str, **options: Any) -> Callable[[], Bombs]:
    """A picture of one colour, as large as the format packs into a few hundred KiB."""

    def make() -> Bombs:
        stream = io.BytesIO()
        Image.new("L", (10_000, 10_000)).save(stream, **options)
        yield suffix, stream.getvalue()

    return make


def _tiled_tiff(side: int) -> bytes:
    """A picture of 4 x 4 pixels in one tile of that side."""
    pixels = zlib.compress(bytes(1 << 20), 9)
    entries = [(256, 4), (257, 4), (258, 8), (259, 8), (262, 1), (277, 1), (322, side), (323, side)]
    entries += [(324, 8 + 2 + 12 * 10 + 4), (325, len(pixels))]
    table = b"".join(struct.pack("<2H2I", tag, 4, 1, value) for tag, value in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + table + bytes(4) + pixels


def tiffs() -> Bombs:
    yield from of_one_colour(".tif", format="TIFF", compression="tiff_lzw")()
    yield ".tif", _tiled_tiff(SIDE - SIDE % 16)
    yield ".tif", _tiled_tiff(4096)


def exrs() -> Bombs:
    """Pictures of tiles that they do not have."""
    for side, tile in (4, SIDE), (SIDE, 64), (4000, 1):
        window = struct.pack("<4i", 0, 0, side - 1, side - 1)
        attributes = {
            b"channels\0chlist": b"Y\0" + struct.pack("<iB3x2i", 1, 0, 1, 1) + b"\0",
            b"compression\0compression": b"\3",
            b"dataWindow\0box2i": window,
            b"displayWindow\0box2i": window,
            b"lineOrder\0lineOrder": b"\0",
            b"pixelAspectRatio\0float": struct.pack("<f", 1.0),
            b"screenWindowCenter\0v2f": bytes(8),
            b"screenWindowWidth\0float": struct.pack("<f", 1.0),
            b"tiles\0tiledesc": struct.pack("<2IB", tile, tile, 0),
        }
        head = b"".join(name + b"\0" + struct.pack("<I", len(v)) + v for name, v in attributes.items())
        yield ".exr", b"v/1\1" + struct.pack("<I", 0x202) + head + b"\0" + bytes(1 << 16)


def webps() -> Bombs:
    yield from of_one_colour(".webp", format="WEBP", lossless=True)()
    stream = io.BytesIO()
    pictures = [Image.new("L", (3000, 3000), k) for k in range(10)]
    pictures[0].save(stream, "WEBP", lossless=True, save_all=True, append_images=pictures[1:])
    yield ".webp", stream.getvalue()


def bmps() -> Bombs:
    for side, bits, packing, colours in (SIDE, 24, 0, 0), (4000, 8, 1, HUGE), (4000, 32, 0, 0):
        head = struct.pack("<IiiHHII2iII", 40, side, -side, 1, bits, packing, 0, 0, 0, colours, 0)
        yield ".bmp", b"BM" + struct.pack("<IHHI", 1000, 0, 0, 54) + head + bytes(1000)


def pfms() -> Bombs:
    yield ".pfm", b"Pf\n60000 60000\n-1.0\n"
    yield ".pfm", b"Pf\n2000000000 2000000000\n-1.0\n"
