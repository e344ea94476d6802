"""ZIP archives as file trees: read in place, never unpacked as a whole.

Archives from strangers are safe to open: names that lead out of the archive, links, encrypted files and files that
unpack to far more than they are packed in are refused before anything is read.
"""

import contextlib
import shutil
import stat
import tempfile
import threading
import weakref
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO, BinaryIO

from hyjax.data.file_tree import IGNORED, LARGEST_READ, FileTree
from hyjax.util.errors import InputError
from hyjax.util.reading import check_most, check_regular, open_regular

ARCHIVES = (".zip", ".r3d")
MOST_FILES = 1_000_000
LARGEST_RATIO = 200
"""Largest ratio of unpacked to packed size above `HARMLESS_BYTES` bytes; depth maps of a bare wall reach 50."""
HARMLESS_BYTES = 1 << 24
LARGEST_FILE = 1 << 32


class Archive(FileTree):
    """A ZIP archive. Threads may read from it at the same time."""

    def __init__(self, path: Path) -> None:
        check_regular(path)
        try:
            self._zip = zipfile.ZipFile(path)
            entries = [entry for entry in self._zip.infolist() if not entry.is_dir()]  # fails for an empty name
        except Exception as error:  # BadZipFile, OSError, NotImplementedError, struct.error, UnicodeDecodeError, …
            raise InputError(f"{path}: not a readable ZIP archive ({error})") from None
        if len(entries) > MOST_FILES:
            raise InputError(f"{path}: holds {len(entries)} files; at most {MOST_FILES} are read")
        for entry in entries:
            _check_entry(path, entry)
        total, packed = sum(entry.file_size for entry in entries), path.stat().st_size
        if total > HARMLESS_BYTES + LARGEST_RATIO * packed:
            raise InputError(
                f"{path}: refused, its files unpack to {total / 2**20:.0f} MiB, it has {packed / 2**20:.3g} MiB; "
                "unpack it yourself if you trust it"
            )
        names = [entry.filename for entry in entries if not set(PurePosixPath(entry.filename).parts) & {*IGNORED}]
        super().__init__(path, names)
        if len(self._known) < len(names):
            raise InputError(f"{path}: two files have the same name; remove or rename one")
        self._lock = threading.Lock()
        self._copies = _Copies()

    @property
    def folder(self) -> Path:
        raise InputError(f"{self.path}: this layout is not read from an archive; unpack it and give its folder")

    def read(self, name: str) -> bytes:
        check_most(self.size(name), LARGEST_READ, self.where(name))
        # With a count, zipfile unpacks no more than the size that was checked; without, all that is packed.
        with self._unpacking(name) as packed:
            return packed.read(self.size(name))

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="hyjax-") as folder:
            yield self._copy(name, folder)

    @contextlib.contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        inside = self._inside(name)
        if inside not in self._copies:
            folder = tempfile.mkdtemp(prefix="hyjax-")
            weakref.finalize(self._copies, shutil.rmtree, folder, ignore_errors=True)
            self._copies[inside] = self._copy(name, folder)
        with open_regular(self._copies[inside], self.where(name)) as file:
            yield file

    def ends(self, name: str, count: int) -> tuple[bytes, bytes]:
        content = self.read(name)
        return content[:count], content[-count:]

    def size(self, name: str) -> int:
        return self._zip.getinfo(self._inside(name)).file_size

    def _copy(self, name: str, folder: str) -> Path:
        """A copy of a file in a folder, made piece by piece."""
        copy = Path(folder) / PurePosixPath(name).name
        with self._unpacking(name) as packed, copy.open("wb") as file:
            shutil.copyfileobj(packed, file, 1 << 20)
        return copy

    @contextlib.contextmanager
    def _unpacking(self, name: str) -> Iterator[IO[bytes]]:
        inside = self._inside(name)
        try:
            with self._lock, self._zip.open(inside) as packed:
                yield packed
        except Exception as error:  # BadZipFile, OSError, zlib.error, lzma.LZMAError, …
            raise InputError(f"{self.where(name)}: damaged in the archive ({error})") from None

    def _marks(self) -> Iterator[str]:
        return (f"{e.filename} {e.file_size} {e.CRC}" for e in map(self._zip.getinfo, self.names))


class _Copies(dict[str, Path]):
    """Files that were unpacked, by name; they go with it."""


def _check_entry(path: Path, entry: zipfile.ZipInfo) -> None:
    """Raise `InputError` for an entry that no capture has."""
    name = entry.filename
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if (
        not name
        or "\0" in entry.orig_filename
        or name.startswith(("/", "\\"))
        or ".." in parts
        or ":" in name.partition("/")[0]
    ):
        raise InputError(f"{path}: refused, it holds a file named {name[:60]!r}, which leads out of the archive")
    if stat.S_ISLNK(entry.external_attr >> 16):
        raise InputError(f"{path}: refused, it holds a link, {name[:60]!r}")
    if entry.flag_bits & 1:
        raise InputError(f"{path}: {name[:60]!r} is encrypted; unpack the archive and give its folder")
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # the others unpack without a bound
        raise InputError(
            f"{path}: {name[:60]!r} is packed by method {entry.compress_type}; pack it anew, by deflate"
        )
    ratio = entry.file_size / max(entry.compress_size, 1)
    if entry.file_size > LARGEST_FILE or (entry.file_size > HARMLESS_BYTES and ratio > LARGEST_RATIO):
        raise InputError(
            f"{path}: refused, {name[:60]!r} unpacks to {entry.file_size / 2**20:.0f} MiB from "
            f"{entry.compress_size / 2**20:.3g} MiB; unpack the archive yourself if you trust it"
        )
