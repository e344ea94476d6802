"""File trees: the files of a capture by their names, in a folder or in a ZIP archive; see `hyjax.data.trees`."""

import contextlib
import copy
import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from hyjax.util.errors import InputError
from hyjax.util.reading import LARGEST_TEXT, as_text, check_most, open_regular, read_bytes

LARGEST_READ = 1 << 30
"""Bytes of a file that is read whole."""
IGNORED = ("__MACOSX", ".DS_Store", "Thumbs.db")


class FileTree:
    """Files by name, such as `depth/000012.png`, below a folder on disk.

    Args:
        names: of all files; separated by slashes, relative to the folder.
    """

    path: Path
    names: tuple[str, ...]

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self.path, self.names = path, tuple(sorted(names))
        self._known = frozenset(self.names)
        self._root, self._top = path.resolve(), ""
        self._whole: FileTree | None = None

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def below(self, folder: str, suffix: str = "") -> list[str]:
        """Names of the files right in a folder (`""` for the top) that end with `suffix`, in any case."""
        top = f"{folder}/" if folder else ""
        return [
            name
            for name in self.names
            if name.startswith(top) and "/" not in name[len(top) :] and name.lower().endswith(suffix.lower())
        ]

    def folders(self) -> list[str]:
        """Names of the folders at the top."""
        return sorted({name.partition("/")[0] for name in self.names if "/" in name})

    def where(self, name: str) -> str:
        """Name of a file in messages."""
        return f"{self.path}/{name}"

    def subtree(self, folder: str) -> "FileTree":
        """The files below a folder."""
        part = copy.copy(self)
        part.path, part._top, part._whole = self.path / folder, f"{self._top}{folder}/", self
        part.names = tuple(n.removeprefix(f"{folder}/") for n in self.names if n.startswith(f"{folder}/"))
        part._known = frozenset(part.names)
        return part

    @property
    def folder(self) -> Path:
        """The folder on disk, for readers that need one."""
        return self._root / self._top

    def read(self, name: str) -> bytes:
        """Content of a file."""
        return read_bytes(self._file(name), self.where(name), LARGEST_READ)

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """A file's path on disk: its own, or, of an archive, that of a copy that is there for the block alone."""
        yield self._file(name)

    @contextlib.contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        """A file opened for reading from any place in it, for the block alone.

        Of an archive it is a copy on disk, which is made once and is there as long as the tree.
        """
        with open_regular(self._file(name), self.where(name)) as file:
            yield file

    def ends(self, name: str, count: int) -> tuple[bytes, bytes]:
        """The first and the last `count` bytes of a file."""
        try:
            with open_regular(self._file(name), self.where(name)) as file:
                head = file.read(count)
                file.seek(-min(count, self.size(name)), os.SEEK_END)
                return head, file.read(count)
        except OSError as error:
            raise InputError(f"{self.where(name)}: cannot read ({error.strerror})") from None

    def size(self, name: str) -> int:
        """Bytes of a file."""
        try:
            return self._file(name).stat().st_size
        except OSError as error:
            raise InputError(f"{self.where(name)}: cannot read ({error.strerror})") from None

    def fingerprint(self) -> str:
        """A key that changes when any file does; no file is read for it."""
        if self._whole is not None:
            return digest_of(self._whole.fingerprint(), [self._top.removeprefix(self._whole._top)])
        return digest_of(str(self._root), self._marks())

    def text(self, name: str, most: int = LARGEST_TEXT) -> str:
        """A text file of at most so many bytes."""
        if name in self:
            check_most(self.size(name), most, self.where(name))
        return as_text(self.read(name), self.where(name))

    def _marks(self) -> Iterator[str]:
        entries = ((name, (self._root / name).stat()) for name in self.names)
        return (f"{name} {status.st_size} {status.st_mtime_ns}" for name, status in entries)

    def _inside(self, name: str) -> str:
        """Name of a file in the whole tree."""
        if name not in self:
            raise InputError(f"{self.where(name)}: no such file")
        return self._top + name

    def _file(self, name: str) -> Path:
        return self._root / self._inside(name)


def digest_of(top: str, lines: Iterable[str]) -> str:
    """A key of some lines; names that are not UTF-8 may be in them."""
    return hashlib.sha256("\n".join([top, *lines]).encode(errors="surrogateescape")).hexdigest()
