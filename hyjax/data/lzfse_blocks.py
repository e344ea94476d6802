"""LZFSE's blocks: how much a file unpacks to, which the package `lzfse` does not bound.

Source: Apple's reference implementation, github.com/lzfse/lzfse, `lzfse_internal.h`.
"""

import struct

FEWEST_BYTES = 1 << 14
"""Bytes that a block unpacks to, but for the last ones; the reference implementation's have more."""
SMALL_FILE_BLOCKS = 4
"""Blocks that a small file may have."""
LONG_HEADER = 772
"""Bytes of the header of a `bvx1`."""


def unpacked_size(content: bytes) -> int | None:
    """Bytes that LZFSE-compressed content says it unpacks to; None if it is damaged or its blocks are too many.

    A block that lies about its size unpacks to 24 MB at most, hence their number is bounded too.

    Example:
        >>> unpacked_size(b"bvx-" + (3).to_bytes(4, "little") + b"abc" + b"bvx$")
        3
    """
    at = total = count = 0
    try:
        while (kind := content[at : at + 4]) != b"bvx$":
            (size,) = struct.unpack_from("<I", content, at + 4)
            at += _length(kind, content, at)
            total, count = total + size, count + 1
    except (struct.error, KeyError):
        return None
    return total if count <= SMALL_FILE_BLOCKS + total // FEWEST_BYTES else None


def _length(kind: bytes, content: bytes, at: int) -> int:
    """Bytes of a block with its header."""
    if kind == b"bvx-":
        return 8 + struct.unpack_from("<I", content, at + 4)[0]
    if kind == b"bvxn":
        return 12 + struct.unpack_from("<I", content, at + 8)[0]
    if kind == b"bvx1":
        return LONG_HEADER + sum(struct.unpack_from("<2I", content, at + 20))
    if kind == b"bvx2":
        literals, matches, header = struct.unpack_from("<3Q", content, at + 8)
        return max(header & 0xFFFFFFFF, 32) + (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
    raise KeyError(kind)
