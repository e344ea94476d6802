"""The folder of files that can be computed again, and arrays in it."""

import contextlib
import logging
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import platformdirs

from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, remove_stale

T = TypeVar("T")
Arrays = Mapping[str, np.ndarray]
_log = logging.getLogger(__name__)
_refused: set[Path] = set()
"""Folders that could not be written, reported once each."""


def cache_folder() -> Path:
    """The folder for rebuildable files: `$HYJAX_CACHE` if set, else the user's cache folder. Not created here."""
    override = os.environ.get("HYJAX_CACHE")
    return Path(override) if override else platformdirs.user_cache_path("hyjax")


def cached_arrays(
    file: Path, parse: Callable[[Arrays], T], make: Callable[[], Arrays], *, compressed: bool = False
) -> T:
    """Result of arrays that are read from a file if it is there and whole, else made and stored.

    Warnings tell of a damaged file and of a folder that cannot be written.

    Args:
        parse: turns the arrays into the result; any error counts as damage of the file.
    """
    kept = read_kept(file, parse)
    if kept is not None:
        return kept
    arrays = make()
    keep_arrays(file, arrays, compressed=compressed)
    return parse(arrays)


def read_kept(file: Path, parse: Callable[[Arrays], T]) -> T | None:
    """Result of the arrays of a file; None if there is none, or a damaged one, with a warning."""
    if file.is_file():
        try:
            # Opened here, since np.load leaves a damaged file open.
            with file.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
                return parse({name: stored[name] for name in stored.files})
        except Exception as error:  # Damage shows itself in a dozen ways; all mean the same.
            _log.warning("%s: damaged (%s), it is made again", file, error)
    return None


def keep_arrays(file: Path, arrays: Arrays, *, compressed: bool = False) -> None:
    """Store arrays in a file of a cache folder; a folder that cannot be written is a warning."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(file.parent)
        with atomic_write(file) as part:
            (np.savez_compressed if compressed else np.savez)(part, **arrays)  # type: ignore[arg-type]
    except (OSError, InputError) as error:
        tell_unkept(file.parent, error)


def tell_unkept(folder: Path, error: Exception) -> None:
    """Warn, once for a folder and those in it, that computed data cannot be kept there."""
    if not any(folder == told or told in folder.parents or folder in told.parents for told in _refused):
        _refused.add(folder)
        reason = getattr(error if isinstance(error, OSError) else error.__context__, "strerror", None) or error
        _log.warning(
            "%s: cannot keep files there for the next start (%s); HYJAX_CACHE names another folder", folder, reason
        )


def touch(file: Path) -> None:
    """Note that a file has been used, for `remove_oldest`."""
    with contextlib.suppress(OSError):  # of a folder that is only read
        os.utime(file)


def remove_oldest(folder: Path, pattern: str, most: int) -> None:
    """Remove the files that were used longest ago, until the others have no more than so many bytes."""
    with contextlib.suppress(OSError):  # another process may remove the same
        kept = 0
        for status, file in sorted(((f.stat(), f) for f in folder.glob(pattern)), key=lambda x: -x[0].st_mtime):
            kept += status.st_size
            if kept > most:
                file.unlink(missing_ok=True)
