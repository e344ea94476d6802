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
        except (struct.error, ValueError, KeyError, UnboundLocalError):
            whole = False
    if not whole:
        raise OSError(errno.ENOSPC, "not all of it was written", where)


def _png(file: BinaryIO, size: int) -> bool:
    """Whether all chunks are there with their checksums, the last one at the end of the file."""
    if file.read(8) != b"\x89PNG\r\n\x1a\n":
        return False
    while True:
        length, kind = struct.unpack(">I4s", file.read(8))
        content = file.read(length)
        (checksum,) = struct.unpack(">I", file.read(4))
        if len(content) != length or zlib.crc32(content, zlib.crc32(kind)) != checksum:
            return False
        if kind == b"IEND":
            return file.tell() == size


def _exr(file: BinaryIO, size: int) -> bool:
    """Whether the table of offsets is written, and the last block of lines ends where the file does.

    The layout is that of a file of one part in lines: <https://openexr.com/en/latest/OpenEXRFileLayout.html>.
    """
    if file.read(4) != b"v/1\x01":
        return False
    file.read(4)
    while name := _text(file):  # attributes, up to an empty name
        kind, length = _text(file), struct.unpack("<i", file.read(4))[0]
        value = file.read(length)
        if (name, kind) == (b"dataWindow", b"box2i"):
            _, top, _, bottom = struct.unpack("<4i", value)
        elif name == b"compression":
            lines = {0: 1, 1: 1, 2: 1, 3: 16}[value[0]]  # none, RLE, ZIP of single lines, ZIP
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


def _text(file: BinaryIO) -> bytes:
    letters = bytearray()
    while letter := file.read(1):
        if letter == b"\0":
            return bytes(letters)
        letters += letter
    raise ValueError("the header has no end")


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


_CHECKS: dict[str, Callable[[BinaryIO, int], bool]] = {".png": _png, ".exr": _exr, ".mp4": _mp4}
