"""Checks that a written file is whole, for formats whose libraries do not say that the disk was full.

OpenImageIO reports no failed write of a PNG; video containers may lose their index. What Python itself writes
(texts, NumPy's archives, safetensors) raises `OSError` and needs no check.
"""

import errno
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

MOST_CHUNKS = 1 << 18
"""Of a PNG: libraries write eight kilobytes or more in each."""
LONGEST_NAME = 255
"""Letters of an EXR attribute's name."""
MOST_ATTRIBUTES = 1000
LARGEST_ATTRIBUTE = 1 << 24
"""Bytes of its value: a preview picture is the largest."""


def check_whole(path: Path, where: str) -> None:
    """Check what was written at a path, by its suffix; files of other formats pass.

    Args:
        path: of the file.
        where: final name of the file, for the message.

    Raises:
        OSError: `ENOSPC`, the file is not whole.
    """
    check = _CHECKS.get(path.suffix.lower())
    if check is None:
        return
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        try:
            whole = check(file, size)
        except (struct.error, ValueError, KeyError, IndexError):
            whole = False
    if not whole:
        raise OSError(errno.ENOSPC, "not all of it was written", where)


def is_whole_png(file: BinaryIO, size: int, *, foreign: bool = False) -> bool:
    """Whether all chunks are there with their checksums, the last one at the end of the file.

    Args:
        file: at its start.
        size: bytes in it.
        foreign: written by another program: bytes may follow the last chunk, and checksums of chunks that no
            decoder needs may be wrong.

    Raises:
        struct.error: the file ends within a chunk.
    """
    if file.read(8) != b"\x89PNG\r\n\x1a\n":
        return False
    order = b""  # of the chunks that decoders need; libpng writes to stderr if it is another
    for _ in range(MOST_CHUNKS):
        length, kind = struct.unpack(">I4s", file.read(8))
        content = file.read(min(length, size))  # all that is announced is set aside
        (checksum,) = struct.unpack(">I", file.read(4))
        needed = kind[:1].isupper()
        if not (kind.isalpha() and kind[2:3].isupper()) or len(content) != length:  # libpng writes to stderr
            return False
        if (needed or not foreign) and zlib.crc32(content, zlib.crc32(kind)) != checksum:
            return False
        if needed and not (kind == b"IDAT" and order.endswith(b"IDAT")):
            order += kind
        if kind == b"PLTE" and (length % 3 or not 3 <= length <= 768):
            return False
        if kind == b"IEND":
            return (foreign or file.tell() == size) and order in (b"IHDRIDATIEND", b"IHDRPLTEIDATIEND")
    return False


def _exr(file: BinaryIO, size: int) -> bool:
    """Whether the table of offsets is written, and the last block of lines ends where the file does.

    The layout is that of a file of one part in lines: <https://openexr.com/en/latest/OpenEXRFileLayout.html>.
    """
    attributes = exr_attributes(file)
    _, top, _, bottom = struct.unpack("<4i", attributes[b"dataWindow"][1])
    lines = {0: 1, 1: 1, 2: 1, 3: 16}[attributes[b"compression"][1][0]]  # none, RLE, ZIP of single lines, ZIP
    count = -(-(bottom - top + 1) // lines)
    offsets = struct.unpack(f"<{count}Q", file.read(8 * count))
    if 0 in offsets:
        return False
    ends = []
    for offset in offsets:
        file.seek(offset)
        _, length = struct.unpack("<ii", file.read(8))
        ends.append(offset + 8 + length)
    return max(ends) == size


def exr_attributes(file: BinaryIO) -> dict[bytes, tuple[bytes, bytes]]:
    """(type, value) of each attribute in the header of an EXR file, by name; the file is left behind it.

    Raises:
        ValueError: it is none, or its header is damaged.
        struct.error: the file ends within its header.
    """
    if file.read(4) != b"v/1\x01":
        raise ValueError("not an EXR file")
    file.read(4)
    found: dict[bytes, tuple[bytes, bytes]] = {}
    for _ in range(MOST_ATTRIBUTES):
        if not (name := _text(file)):  # the end of the header
            return found
        kind, length = _text(file), struct.unpack("<I", file.read(4))[0]
        if length > LARGEST_ATTRIBUTE:
            raise ValueError("the header is damaged")
        found[name] = kind, file.read(length)
    raise ValueError("the header has no end")


def _text(file: BinaryIO) -> bytes:
    letters = bytearray()
    while (letter := file.read(1)) != b"\0":
        if not letter or len(letters) > LONGEST_NAME:
            raise ValueError("the header has no end")
        letters += letter
    return bytes(letters)


def _mp4(file: BinaryIO, size: int) -> bool:
    """Whether the boxes fill the file and the index is one of them."""
    kinds, place = set(), 0
    while place < size:
        file.seek(place)
        length, kind = struct.unpack(">I4s", file.read(8))
        if length == 1:
            (length,) = struct.unpack(">Q", file.read(8))
        if length < 8:
            return False
        kinds.add(kind)
        place += length
    return place == size and {b"ftyp", b"moov", b"mdat"} <= kinds


_CHECKS: dict[str, Callable[[BinaryIO, int], bool]] = {".png": is_whole_png, ".exr": _exr, ".mp4": _mp4}
