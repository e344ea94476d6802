"""Rows of a sweep: an append-only file for each worker; merged on reading."""

import contextlib
import json
import math
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import msgspec

from hyjax.util.errors import InputError
from hyjax.util.files import append, write_text
from hyjax.util.reading import open_regular, parse_json, read_text

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

Row = dict[str, Any]
ERROR = "error"
"""Kind of a row with an error in place of a result."""
DRIVER_FILE = "driver.txt"
"""Name of the file with the identity of the driver whose batches may write."""
PART_PREFIX = "part-"
"""Beginning of the name of a folder with a part of a sweep."""
MOST_DRIVER_BYTES = 1000
"""Largest size of that file, in bytes."""
TAKE_OVER_SECONDS = 900.0
"""Time, in seconds, that a driver waits for batches of an earlier one."""


class _Head(msgspec.Struct):
    key: str
    kind: str


_heads = msgspec.json.Decoder(_Head)
"""Decoder of the heads of rows, which suffice at the start of a resumed sweep."""


class _Place(NamedTuple):
    path: Path
    start: int
    length: int
    is_error: bool


class RowStore:
    """Store of the rows in a folder, one for each key: the first result, else an error.

    Only the places of rows are kept in memory. A line that a kill cut off counts for nothing, but see `damaged`.

    Args:
        folder: of the files `rows-HOST-PID-N.jsonl`, and of the folders of parts of a sweep with such files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._ends: dict[Path, int] = {}
        self._places: dict[str, _Place] = {}
        self._repeated: set[str] = set()
        self._damaged: set[tuple[Path, int]] = set()

    def files(self) -> list[Path]:
        """Files of rows."""
        patterns = ("rows-*.jsonl", f"{PART_PREFIX}*/rows-*.jsonl")
        return sorted(path for pattern in patterns for path in self.folder.glob(pattern))

    def refresh(self) -> "RowStore":
        """Read rows appended since the last call, and return the store."""
        for path in self.files():
            start = self._ends.get(path, 0)
            try:
                if path.stat().st_size <= start:
                    continue
                with open_regular(path) as file:
                    file.seek(start)
                    for line in file:
                        if not line.endswith(b"\n"):
                            break
                        self._add(path, start, line)
                        start += len(line)
            except OSError as error:
                raise InputError(f"{path}: cannot read ({error.strerror or error})") from None
            self._ends[path] = start
        return self

    def _add(self, path: Path, start: int, line: bytes) -> None:
        try:
            head = _heads.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):  # of a line that a kill cut off
            self._damaged.add((path, start))
            return
        entry = _Place(path, start, len(line), head.kind == ERROR)
        before = self._places.get(head.key)
        if before is None or (before.is_error and not entry.is_error):
            self._places[head.key] = entry
        elif not entry.is_error:
            self._repeated.add(head.key)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, key: object) -> bool:
        """Whether there is a result for a key."""
        return key in self._places and not self._places[str(key)].is_error

    def done(self) -> set[str]:
        """Keys with a result."""
        return {key for key, entry in self._places.items() if not entry.is_error}

    def get(self, key: str) -> Row | None:
        """Row of a key."""
        if key not in self._places:
            return None
        entry = self._places[key]
        with open_regular(entry.path) as file:
            return _row(file, entry)

    def read(self) -> Iterator[Row]:
        """One row for each key, file by file."""
        self.refresh()
        for path in self.files():
            places = [entry for entry in self._places.values() if entry.path == path]
            with open_regular(path) as file:
                for entry in places:
                    yield _row(file, entry)

    def duplicates(self) -> int:
        """Keys with more than one result."""
        self.refresh()
        return len(self._repeated)

    def damaged(self) -> int:
        """Lines that hold no row, those without an end among them."""
        self.refresh()
        cut_off = sum(path.stat().st_size > self._ends.get(path, 0) for path in self.files())
        return len(self._damaged) + cut_off

    def take_over(self, driver: str, tell: Callable[[str], None]) -> None:
        """Make `driver` the only one whose batches may write, and wait for batches of others."""
        write_text(self.folder / DRIVER_FILE, driver)
        end, announced = time.monotonic() + TAKE_OVER_SECONDS, False
        for path in self.files() if fcntl else ():
            while _is_locked(path):
                if time.monotonic() > end:
                    raise InputError(f"{path}: a worker of an earlier run still writes there; try again later")
                if not announced:
                    tell("a worker of an earlier run still finishes its task; waiting for it")
                    announced = True
                time.sleep(0.05)

    def driver(self) -> str:
        """Identity of the driver whose batches may write."""
        try:
            return read_text(self.folder / DRIVER_FILE, most=MOST_DRIVER_BYTES)
        except InputError:
            return ""


def _row(file: BinaryIO, entry: _Place) -> Row:
    file.seek(entry.start)
    row: Row = parse_json(file.read(entry.length), str(entry.path))
    return row


class RowWriter:
    """Writer of a new file of rows, of this process alone."""

    def __init__(self, folder: Path) -> None:
        number, name = 0, f"rows-{socket.gethostname()}-{os.getpid()}"
        while True:
            self.path = folder / f"{name}-{number}.jsonl"
            try:
                self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
                break
            except FileExistsError:
                number += 1
            except OSError as error:
                raise _full(self.path, error) from None
        self._end = 0

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the file, a signal to other drivers that rows may come."""
        if fcntl:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            if fcntl:
                with contextlib.suppress(OSError):
                    fcntl.flock(self._file, fcntl.LOCK_UN)

    def add(self, row: Row) -> None:
        """Append a row atomically."""
        line = (json.dumps(_finite(row)) + "\n").encode()
        try:
            append(self._file, line)
        except OSError as error:
            raise _full(self.path, error) from None
        self._end += len(line)

    def close(self) -> None:
        """Close the file, and remove it if it is empty."""
        os.close(self._file)
        if not self._end:
            self.path.unlink(missing_ok=True)


def _finite(value: Any) -> Any:
    """Value with None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is_locked(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _full(path: Path, error: OSError) -> InputError:
    reason = error.strerror or error
    return InputError(f"{path}: cannot write ({reason}); the rows so far are kept: make room and resume")
