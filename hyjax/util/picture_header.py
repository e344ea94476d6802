"""What a picture's file says of itself, checked before any library reads it.

A small file may announce any number of pixels, and a library that believes it takes all memory; libpng writes of
damaged chunks to stderr. Formats are known by their first bytes, whatever the name: PNG, JPEG, OpenEXR and PNM are
looked at here; of TIFF, WebP and BMP the size that OpenImageIO finds is checked.
"""

import os
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

from hyjax.util.errors import InputError, shown
from hyjax.util.reading import open_regular
from hyjax.util.whole_files import exr_attributes, is_whole_png

VARIABLE = "HYJAX_MOST_MEGAPIXELS"
"""Environment variable with the largest picture that is read, in millions of pixels."""
MOST_MEGAPIXELS = 64.0
MOST_CHANNELS = 4
"""In the mean: a picture of the most pixels may have four channels, a smaller one more."""
PACKED_FREELY = 16e6
"""Pixels up to which a picture may be packed as tightly as its format can."""
MOST_PER_BYTE = 500
"""Pixels in a byte of a larger one; a photo has 2 to 20, a blank PNG a thousand."""
MOST_PASSES = 1 << 30
"""Pixels times scans of a JPEG: a progressive one is gone through once for each scan, of which it needs ten."""
HEAD = 1 << 16
"""Bytes of a PNG within which its palette begins."""
MOST_MARKERS = 1 << 16
"""Of a JPEG, without those of restarts: a large colour profile takes some hundred."""
LARGEST_FILE = 1 << 30


class Declared(NamedTuple):
    """What a header says: sides in pixels, and how often a decoder goes through them."""

    width: int
    height: int
    passes: int = 1


def check_picture(path: Path, where: str) -> None:
    """Raise `InputError` unless a file begins as a picture does, of a size that can be read if its header is known.

    Args:
        path: of the file.
        where: what messages call it.
    """
    with open_regular(path, where) as file:
        size = os.fstat(file.fileno()).st_size
        if size > LARGEST_FILE:
            raise InputError(f"{where}: has over {LARGEST_FILE >> 20} MiB; too large for a picture")
        start = file.read(12)
        if OTHERS.match(start):
            return
        kind = next((kind for mark, kind in FORMATS.items() if start.startswith(mark)), None)
        if kind is None:
            raise InputError(f"{where}: not a readable picture; read are {READ}")
        file.seek(0)
        try:
            declared = kind(file, size)
        except (struct.error, ValueError, KeyError, IndexError, OSError):
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
    if width * height > PACKED_FREELY and width * height > MOST_PER_BYTE * size:
        raise InputError(
            f"{where}: {width}x{height} pixels in {size} bytes; of so large a picture at most {MOST_PER_BYTE} a "
            "byte are read"
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
    head = file.read(28)
    if head[8:16] != b"\0\0\0\x0dIHDR" or (head[25], head[24]) not in PNG_FORMS or head[26:28] != b"\0\0":
        return None
    width, height = struct.unpack_from(">2I", head, 16)
    file.seek(0)
    whole = is_whole_png(file, size, foreign=True)
    file.seek(0)
    has_colours = head[25] != 3 or b"PLTE" in file.read(HEAD)
    return Declared(width, height) if whole and has_colours else None


def _jpeg(file: BinaryIO, size: int) -> Declared | None:
    """The size in the first frame header, and the scans up to the picture's end: phones put films behind it."""
    content = file.read()
    at, scans, sides = 2, 0, None
    for _ in range(MOST_MARKERS):
        found = MARKER.search(content, at)
        if found is None or found[0] == END:
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
"""A JPEG's marker that is none of a restart; between two of them are the bytes of a scan."""
END = b"\xff\xd9"
FRAME_HEADERS = tuple(kind for kind in range(0xC0, 0xD0) if kind not in (0xC4, 0xC8, 0xCC))
"""JPEG's markers of headers with the size."""


def _exr(file: BinaryIO, size: int) -> Declared | None:
    attributes = exr_attributes(file)
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"][1])
    return Declared(right - left + 1, bottom - top + 1)


def _pnm(file: BinaryIO, size: int) -> Declared | None:
    words = re.sub(rb"#[^\n]*", b"", file.read(4096)).split(maxsplit=3)
    if not all(word.isdigit() and len(word) < 10 for word in words[1:3]):
        return None
    return Declared(int(words[1]), int(words[2]))


PNG_FORMS = {
    *((kind, bits) for kind in (0, 2, 3, 4, 6) for bits in (8, 16)),
    *((kind, bits) for kind in (0, 3) for bits in (1, 2, 4)),
} - {(3, 16)}
"""Kinds of colour and bits of each channel that a PNG may have."""
FORMATS: dict[bytes, Callable[[BinaryIO, int], Declared | None]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8\xff": _jpeg,
    b"v/1\x01": _exr,
    **{b"P" + digit: _pnm for digit in (b"1", b"2", b"3", b"4", b"5", b"6")},
}
"""How a file of each format begins, and what reads its header."""
OTHERS = re.compile(rb"II[*+]\0|MM\0[*+]|RIFF.{4}WEBP|BM", re.DOTALL)
"""How those begin whose headers OpenImageIO alone reads."""
READ = "PNG, JPEG, OpenEXR, PNM, TIFF, WebP and BMP"
