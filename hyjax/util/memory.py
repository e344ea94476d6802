"""Memory that a process keeps for its next frame."""

import contextlib
import ctypes
import os
import sys

M_TRIM_THRESHOLD, M_MMAP_MAX, M_ARENA_MAX = -1, -4, -8
"""Parameters of glibc's `mallopt`, see its manual page."""
NEVER_TRIMMED = 2**31 - 1


def keep_freed_memory() -> bool:
    """Whether memory that is freed stays with the process from now on, so that the next frame finds it.

    glibc hands large arrays back to the system and asks for new pages for each, which the system clears one by one:
    half of the time of a cascade of 2048 x 2048 pixels. As much is kept as was ever in use at once. To be called
    before the first thread starts. It does nothing without glibc, or where the environment sets up its allocator.
    """
    if not sys.platform.startswith("linux") or any(
        name == "GLIBC_TUNABLES" or name.startswith("MALLOC_") for name in os.environ
    ):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    wanted = ((M_MMAP_MAX, 0), (M_TRIM_THRESHOLD, NEVER_TRIMMED), (M_ARENA_MAX, 1))
    done = [mallopt(name, value) == 1 for name, value in wanted]
    return all(done)


def release_freed_memory() -> None:
    """Return freed memory to the system, after a large step that does not come with every frame.

    What is kept breaks into pieces too small for the next large one: without this, each large file that a tour
    refused left it 500 MB larger. It does nothing without glibc.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
