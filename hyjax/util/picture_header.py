"""Checks of a picture's file before its pixels are read.

Sizes are those that OpenImageIO finds in the header. Looked at here is what it would not survive in silence: libpng
writes of damaged chunks to stderr, libjpeg goes through a progressive picture as often as it likes. Formats are
known by their first bytes, whatever the name.
"""

import os
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

from hyjax.util.errors import InputError, shown
from hyjax.util.reading import open_regular

VARIABLE = "HYJAX_MOST_MEGAPIXELS"
"""Environment variable with the largest picture that is read, in millions of pixels."""
MOST_MEGAPIXELS = 64.0
MOST_CHANNELS = 4
"""Most channels in the mean: a picture of the most pixels may have four channels, a smaller one more."""
FREELY_PACKED_PIXELS = 16e6
"""Pixels up to which a picture may be packed as tightly as its format can."""
MOST_PIXELS_PER_BYTE = 500
"""Pixels in a byte of a larger one; a photo has 2 to 20, a blank PNG a thousand."""
MOST_PASSES = 1 << 30
"""Pixels times scans of a JPEG: a progressive one is gone through once for each scan, of which it needs ten."""
HEAD_BYTES = 1 << 16
"""Bytes of an EXR within which its data window is looked for; OpenImageIO finds one that a large preview hides."""
MOST_CHUNKS = 1 << 18
"""Most chunks of a PNG: libraries write eight kilobytes or more in each."""
MOST_MARKERS = 1 << 16
"""Most markers of a JPEG, without those of restarts: a large colour profile takes some hundred."""
LARGEST_FILE = 1 << 30


class Declared(NamedTuple):
    """Sides in pixels that a header says, and how often a decoder goes through them."""

    width: int
    height: int
    passes: int = 1


def check_picture(path: Path, where: str) -> None:
    """Raise `InputError` unless a file begins as a picture does, and decoders of PNG and JPEG can be let at it."""
    with open_regular(path, where) as file:
        size = os.fstat(file.fileno()).st_size
        if size > LARGEST_FILE:
            raise InputError(f"{where}: has over {LARGEST_FILE >> 20} MiB; too large for a picture")
        start = file.read(12)
        if not KNOWN_SIGNATURES.match(start):
            raise InputError(f"{where}: not a readable picture; read are {READ_FORMATS}")
        look = next((look for mark, look in HEADER_READERS.items() if start.startswith(mark)), None)
        if look is None:
            return
        file.seek(0)
        try:
            declared = look(file, size)
        except (struct.error, OSError):
            declared = None
    if declared is None or declared.width < 1 or declared.height < 1:
        raise InputError(f"{where}: damaged or truncated picture")
    pixels = declared.width * declared.height
    if pixels * declared.passes > MOST_PASSES:
        raise InputError(f"{where}: {declared.width}x{declared.height} pixels in {declared.passes} scans; too many")
    check_size(declared.width, declared.height, 1, where)
    check_packing(declared.width, declared.height, size, where)


def check_size(width: int, height: int, channels: int, where: str) -> None:
    """Raise `InputError` if a picture has more pixels than are read, or more values than four channels of them."""
    most = _most_pixels()
    if width * height > most or width * height * channels > MOST_CHANNELS * most:
        raise InputError(
            f"{where}: {width}x{height} pixels of {channels} channel(s); at most {most / 1e6:g} million are read, "
            f"of {MOST_CHANNELS} channels: set {VARIABLE} to read larger ones"
        )


def check_packing(width: int, height: int, size: int, where: str) -> None:
    """Raise `InputError` for a large picture with more pixels in a byte of its file than are read."""
    if width * height > FREELY_PACKED_PIXELS and width * height > MOST_PIXELS_PER_BYTE * size:
        raise InputError(
            f"{where}: {width}x{height} pixels in {size} bytes; of so large a picture at most "
            f"{MOST_PIXELS_PER_BYTE} a byte are read"
        )


def _most_pixels() -> float:
    text = os.environ.get(VARIABLE, "")
    try:
        most = float(text or MOST_MEGAPIXELS)
    except ValueError:
        most = 0.0
    if not 0 < most <= 1e6:
        raise InputError(f"{VARIABLE}: must be millions of pixels, such as {MOST_MEGAPIXELS:g}, got {shown(text)}")
    return most * 1e6


def _png(file: BinaryIO, size: int) -> Declared | None:
    """The size, if all chunks that decoders need are there in order, with their checksums."""
    if file.read(8) != PNG_SIGNATURE:
        return None
    order, palette, head = b"", False, b""
    for _ in range(MOST_CHUNKS):
        length, kind = struct.unpack(">I4s", file.read(8))
        content = file.read(min(length, size))  # all that is announced is set aside
        (checksum,) = struct.unpack(">I", file.read(4))
        needed = kind[:1].isupper()
        if not (kind.isalpha() and kind[2:3].isupper()) or len(content) != length:
            return None
        if needed and zlib.crc32(content, zlib.crc32(kind)) != checksum:
            return None
        if needed and not (kind == b"IDAT" and order.endswith(b"IDAT")):
            order += kind
        head = head or content
        palette |= kind == b"PLTE"
        if kind == b"PLTE" and (length % 3 or not 3 <= length <= 768):
            return None
        if kind == b"IEND":
            break
    if order not in (b"IHDRIDATIEND", b"IHDRPLTEIDATIEND") or len(head) != 13:
        return None
    width, height, bits, colour, *methods = struct.unpack(">2I5B", head)
    fits = (colour, bits) in PNG_FORMS and methods[:2] == [0, 0] and (palette or colour != 3)
    return Declared(width, height) if fits else None


def _jpeg(file: BinaryIO, size: int) -> Declared | None:
    """The size in the first frame header, and the scans up to the picture's end: phones put films behind it."""
    content = file.read()
    at, scans, sides = 2, 0, None
    for _ in range(MOST_MARKERS):
        found = MARKER.search(content, at)
        if found is None or found[0] == END_MARKER:
            return None if sides is None else Declared(*sides, max(1, scans))
        at, kind = found.end(), found[0][1]
        if kind in FRAME_HEADERS and sides is None:
            height, width = struct.unpack_from(">2H", content, at + 3)
            sides = width, height
        scans += kind == 0xDA
        if kind >= 0xC0 and kind != 0xD8:  # libjpeg takes no length of others, and looks for markers behind them
            at += struct.unpack_from(">H", content, at)[0]
    return None


MARKER = re.compile(rb"\xff[^\0\xd0-\xd7\xff]")
"""JPEG marker other than a restart's; between two of them are the bytes of a scan."""
END_MARKER = b"\xff\xd9"
FRAME_HEADERS = tuple(kind for kind in range(0xC0, 0xD0) if kind not in (0xC4, 0xC8, 0xCC))
"""JPEG's markers of headers with the size."""


def _exr(file: BinaryIO, size: int) -> Declared | None:
    found = DATA_WINDOW.search(file.read(HEAD_BYTES))
    if found is None:  # behind a large preview
        return Declared(1, 1)
    left, top, right, bottom = struct.unpack("<4i", found[1])
    return Declared(right - left + 1, bottom - top + 1)


PNG_FORMS = {
    *((kind, bits) for kind in (0, 2, 3, 4, 6) for bits in (8, 16)),
    *((kind, bits) for kind in (0, 3) for bits in (1, 2, 4)),
} - {(3, 16)}
"""Kinds of colour and bits of each channel that a PNG may have."""
DATA_WINDOW = re.compile(rb"dataWindow\0box2i\0\x10\0\0\0(.{16})", re.DOTALL)
EXR_SIGNATURE = b"v/1\x01"
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_READERS: dict[bytes, Callable[[BinaryIO, int], Declared | None]] = {
    PNG_SIGNATURE: _png,
    b"\xff\xd8\xff": _jpeg,
    EXR_SIGNATURE: _exr,
}
"""First bytes of files whose headers are looked at here."""
KNOWN_SIGNATURES = re.compile(
    rb"\x89PNG\r\n\x1a\n|\xff\xd8\xff|v/1\x01|P[1-6]|II[*+]\0|MM\0[*+]|RIFF.{4}WEBP|BM", re.DOTALL
)
"""First bytes of files of all formats that are read."""
READ_FORMATS = "PNG, JPEG, OpenEXR, PNM, TIFF, WebP and BMP"
