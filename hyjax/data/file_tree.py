"""File trees: the files of a capture by their names, in a folder or in a ZIP archive that is not unpacked.

Archives from strangers are safe to open: names that lead out of the archive, links, encrypted files and files that
unpack to far more than they are packed in are refused before anything is read.
"""

import abc
import contextlib
import hashlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from hyjax.util.errors import InputError
from hyjax.util.reading import LARGEST_TEXT, as_text, check_most, open_regular

LARGEST_READ = 1 << 30
"""Bytes of a file that is read whole."""
IGNORED = ("__MACOSX", ".DS_Store", "Thumbs.db")


class FileTree(abc.ABC):
    """Files by name, such as `depth/000012.png`; see `hyjax.data.trees.open_tree`.

    Attributes:
        path: the folder or archive, for messages.
        names: of all files, sorted; separated by slashes, relative to the top.
    """

    path: Path
    names: tuple[str, ...]

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self.path, self.names = path, tuple(sorted(names))
        self._known = frozenset(self.names)

    def __contains__(self, name: str) -> bool:
        return name in self._known

    def below(self, folder: str, suffix: str = "") -> list[str]:
        """Names of the files right in a folder (`""` for the top) that end with `suffix`, whatever its case."""
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
        """How messages call a file."""
        return f"{self.path}/{name}"

    @abc.abstractmethod
    def read(self, name: str) -> bytes:
        """Content of a file.

        Raises:
            InputError: there is none of this name, or it cannot be read.
        """

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """A file's path on disk: its own, or, of an archive, that of a copy that is there for the block alone.

        Raises:
            InputError: there is none of this name, or it cannot be read.
        """
        content = self.read(name)
        with tempfile.TemporaryDirectory(prefix="hyjax-") as folder:
            copy = Path(folder) / PurePosixPath(name).name
            copy.write_bytes(content)
            yield copy

    @contextlib.contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        """A file opened for reading from any place in it, for the block alone.

        Of an archive it is a copy on disk, which is made once and is there as long as the tree.

        Raises:
            InputError: there is none of this name, or it cannot be read.
        """
        with self.local(name) as path, open_regular(path, self.where(name)) as file:
            yield file

    def ends(self, name: str, count: int) -> tuple[bytes, bytes]:
        """The first and the last `count` bytes of a file."""
        content = self.read(name)
        return content[:count], content[-count:]

    @abc.abstractmethod
    def size(self, name: str) -> int:
        """Bytes of a file."""

    @abc.abstractmethod
    def fingerprint(self) -> str:
        """A key that changes when any file does; no file is read for it."""

    @property
    def folder(self) -> Path:
        """The folder on disk, for readers that need one.

        Raises:
            InputError: it is an archive.
        """
        raise InputError(f"{self.path}: this layout is not read from an archive; unpack it and give its folder")

    def text(self, name: str, most: int = LARGEST_TEXT) -> str:
        """A text file of at most so many bytes.

        Raises:
            InputError: it cannot be read, is no UTF-8, or is larger than any capture's.
        """
        if name in self:
            check_most(self.size(name), most, self.where(name))
        return as_text(self.read(name), self.where(name))

    def subtree(self, folder: str) -> "FileTree":
        """The files below a folder."""
        return _Subtree(self, folder)


class _Subtree(FileTree):
    """The files of another tree below one of its folders."""

    def __init__(self, tree: FileTree, folder: str) -> None:
        self._tree, self._top = tree, f"{folder}/"
        super().__init__(
            tree.path / folder, (n.removeprefix(self._top) for n in tree.names if n.startswith(self._top))
        )

    @property
    def folder(self) -> Path:
        return self._tree.folder / self._top

    def read(self, name: str) -> bytes:
        return self._tree.read(self._top + name)

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        with self._tree.local(self._top + name) as path:
            yield path

    @contextlib.contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        with self._tree.stream(self._top + name) as file:
            yield file

    def ends(self, name: str, count: int) -> tuple[bytes, bytes]:
        return self._tree.ends(self._top + name, count)

    def size(self, name: str) -> int:
        return self._tree.size(self._top + name)

    def fingerprint(self) -> str:
        return digest_of(self._tree.fingerprint(), [self._top])


def digest_of(top: str, lines: Iterable[str]) -> str:
    """A key of some lines; names that are not UTF-8 may be in them."""
    return hashlib.sha256("\n".join([top, *lines]).encode(errors="surrogateescape")).hexdigest()
