"""Boxes of an MP4 or QuickTime file: how many pictures its tables count.

FFmpeg sets memory aside for each one that a table counts, whether the file has it or not: 2.5 KiB took 4 GiB.

Source: ISO/IEC 14496-12.
"""

import re
import struct
from typing import BinaryIO

import numpy as np

from hyjax.util.errors import InputError

LARGEST_TABLES = 1 << 26
"""Most bytes of all boxes that are not pictures; an hour at 60 a second has some four million."""
MOST_TRACKS = 64
PICTURES = b"mdat"
"""Kind of the box that holds pictures and sound, in which nothing is looked for."""
COMPRESSED = b"cmov"
"""Kind of a box whose content is packed, as no camera writes it."""
COUNTS = {b"stsz": 12, b"stz2": 12}
"""Kinds of tables with one count, and its distance in bytes from the kind's first."""
FRAGMENT, FRAGMENT_COUNT = b"trun", 8
"""Kind of a fragment's table, of which a video has many, and the same distance."""
RUNS = (b"stts", b"ctts")
"""Kinds of tables of pairs: how many samples, and what they have in common."""


def check_counts(file: BinaryIO, where: str) -> None:
    """Raise `InputError` if a table counts more samples than the file has bytes."""
    size = file.seek(0, 2)
    tables = b"".join(_boxes(file, size, where))
    if COMPRESSED in tables:
        raise InputError(f"{where}: not a readable video (its tables are packed)")
    if any(tables.count(kind) > MOST_TRACKS for kind in RUNS):
        raise InputError(f"{where}: not a readable video (over {MOST_TRACKS} tracks)")
    counts = [number for kind, at in COUNTS.items() for number in _numbers(tables, kind, at)]
    counts += [total for kind in RUNS for total in _totals(tables, kind)]
    counts.append(sum(_numbers(tables, FRAGMENT, FRAGMENT_COUNT)))
    if max(counts) > size:
        raise InputError(f"{where}: not a readable video (it counts more pictures than it has bytes)")


def _boxes(file: BinaryIO, size: int, where: str) -> list[bytes]:
    """Contents of the outermost boxes that are no pictures, with their heads."""
    at, found, left = 0, [], LARGEST_TABLES
    while at + 8 <= size:
        file.seek(at)
        head = file.read(16)
        length, kind = struct.unpack(">I4s", head[:8])
        if length == 1 and len(head) == 16:
            (length,) = struct.unpack(">Q", head[8:])
        length = size - at if length == 0 else max(length, 8)
        if kind != PICTURES:
            file.seek(at)
            found.append(file.read(min(length, left + 1)))
            left -= len(found[-1])
            if left < 0:
                raise InputError(f"{where}: not a readable video (over {LARGEST_TABLES >> 20} MiB of tables)")
        at += length
    return found


def _numbers(tables: bytes, kind: bytes, behind: int) -> list[int]:
    """The count of every table of a kind."""
    places = (match.start() + behind for match in re.finditer(kind, tables))
    return [int.from_bytes(tables[at : at + 4], "big") for at in places]


def _totals(tables: bytes, kind: bytes) -> list[int]:
    """Samples of every table of a kind."""
    totals = []
    for match, entries in zip(re.finditer(kind, tables), _numbers(tables, kind, 8)):
        content = tables[match.start() + 12 : match.start() + 12 + 8 * entries]
        pairs = np.frombuffer(content[: len(content) // 8 * 8], ">u4")
        totals.append(int(pairs[::2].sum(dtype=np.uint64)))
    return totals
