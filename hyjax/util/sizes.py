"""Sizes of pictures as they are written on a command line."""

from hyjax.util.errors import InputError

LARGEST_SIDE = 16384
"""Pixels a side."""


def parse_size(text: str | None) -> tuple[int, int] | None:
    """(height, width) from 512 (square) or 640x480 (width x height); None stays None."""
    if text is None:
        return None
    fields = str(text).lower().split("x")
    numbers = all(f.isascii() and f.isdecimal() and len(f) < 6 and 8 <= int(f) <= LARGEST_SIDE for f in fields)
    if not 1 <= len(fields) <= 2 or not numbers:
        raise InputError(
            f"size: {text!r} must be a number (512) or width x height (640x480), each 8 to {LARGEST_SIDE}"
        )
    return int(fields[-1]), int(fields[0])
