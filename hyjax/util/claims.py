"""Locks of files and folders, and folders that one process at a time writes its results to.

The system keeps a lock with the open file and gives it back when the process ends, killed or not. It holds for all
containers that share the folder, where process numbers say nothing, and for machines with shared locks;
NFS has none of folders.
"""

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from hyjax.util.errors import InputError
from hyjax.util.reading import disk_error

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_held: dict[tuple[int, int], list[int]] = {}
"""Folders that this process has claimed: descriptor, and number of claims."""
_changes = threading.Lock()


@contextlib.contextmanager
def claimed(folder: Path | None) -> Iterator[None]:
    """A folder for this process alone, which may claim it several times; a kill ends the claim.

    None is no folder. The system keeps the claim with the open folder, so nothing is written. File systems without
    locks, and Windows, grant it always.
    """
    if fcntl is None or folder is None:
        yield
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        disk_error(folder, error)
    status = os.fstat(descriptor)
    key = status.st_dev, status.st_ino
    with _changes:
        if key in _held:
            os.close(descriptor)
            _held[key][1] += 1
        else:
            if try_lock(descriptor) is False:
                os.close(descriptor)
                raise InputError(
                    f"{folder}: another run writes there; wait until it has ended, or choose another --out"
                )
            _held[key] = [descriptor, 1]
    try:
        yield
    finally:
        with _changes:
            _held[key][1] -= 1
            if not _held[key][1]:
                os.close(_held.pop(key)[0])


def try_lock(descriptor: int) -> bool | None:
    """Whether an open file or folder could be locked, without waiting; None where the file system has no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
