"""File trees: the files of a capture by their names, in a folder or in a ZIP archive that is not unpacked.

Archives from strangers are safe to open: names that lead out of the archive, links, encrypted files and files that
unpack to far more than they are packed in are refused before anything is read.
"""

import abc
import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
import threading
import weakref
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from hyjax.util.errors import InputError

ARCHIVES = (".zip", ".r3d")
MOST_FILES = 1_000_000
LARGEST_RATIO = 200
"""Of unpacked to packed size of files of more than `HARMLESS` bytes; depth maps of a bare wall reach 50."""
HARMLESS = 1 << 24
LARGEST_FILE = 1 << 32
IGNORED = ("__MACOSX", ".DS_Store", "Thumbs.db")


class FileTree(abc.ABC):
    """Files by name, such as `depth/000012.png`; see `open_tree`.

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
        """A file opened for the block to read from any place in it; of an archive, a copy that is made once.

        Raises:
            InputError: there is none of this name, or it cannot be read.
        """
        with self.local(name) as path, _opened(path, self.where(name)) as file:
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

    def text(self, name: str) -> str:
        """A text file.

        Raises:
            InputError: it cannot be read, or is no UTF-8.
        """
        try:
            return self.read(name).decode("utf-8-sig")
        except UnicodeDecodeError:
            raise InputError(f"{self.where(name)}: not a text file") from None

    def subtree(self, folder: str) -> "FileTree":
        """The files below a folder."""
        return _Subtree(self, folder)


def _opened(path: Path, where: str) -> BinaryIO:
    try:
        return path.open("rb")
    except OSError as error:
        raise InputError(f"{where}: cannot read ({error.strerror})") from None


class _Folder(FileTree):
    """A folder on disk. Links below it are followed; the user has put them there."""

    def __init__(self, path: Path) -> None:
        self._root = path.resolve()
        super().__init__(path, _walk(self._root))

    @property
    def folder(self) -> Path:
        return self._root

    def _file(self, name: str) -> Path:
        if name not in self:
            raise InputError(f"{self.where(name)}: no such file")
        return self._root / name

    def read(self, name: str) -> bytes:
        try:
            return self._file(name).read_bytes()
        except OSError as error:
            raise InputError(f"{self.where(name)}: cannot read ({error.strerror})") from None

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        yield self._file(name)

    def ends(self, name: str, count: int) -> tuple[bytes, bytes]:
        try:
            with self._file(name).open("rb") as file:
                head = file.read(count)
                file.seek(-min(count, self.size(name)), os.SEEK_END)
                return head, file.read(count)
        except OSError as error:
            raise InputError(f"{self.where(name)}: cannot read ({error.strerror})") from None

    def size(self, name: str) -> int:
        return self._file(name).stat().st_size

    def fingerprint(self) -> str:
        entries = ((name, (self._root / name).stat()) for name in self.names)
        return _digest(str(self._root), (f"{name} {s.st_size} {s.st_mtime_ns}" for name, s in entries))


def _walk(root: Path) -> Iterator[str]:
    for folder, folders, files in os.walk(root, followlinks=False):
        folders[:] = sorted(name for name in folders if name not in IGNORED)
        for name in files:
            file = Path(folder) / name
            if name not in IGNORED and file.is_file():  # no pipe, device or dangling link
                yield file.relative_to(root).as_posix()


class _Archive(FileTree):
    """A ZIP archive. Threads may read from it at the same time."""

    def __init__(self, path: Path) -> None:
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError) as error:
            raise InputError(f"{path}: not a readable ZIP archive ({error})") from None
        entries = [entry for entry in self._zip.infolist() if not entry.is_dir()]
        if len(entries) > MOST_FILES:
            raise InputError(f"{path}: holds {len(entries)} files; at most {MOST_FILES} are read")
        for entry in entries:
            _check_entry(path, entry)
        names = [entry.filename for entry in entries if not set(PurePosixPath(entry.filename).parts) & {*IGNORED}]
        super().__init__(path, names)
        if len(self._known) < len(names):
            raise InputError(f"{path}: two files have one name; which of them is meant cannot be told")
        self._lock = threading.Lock()
        self._copies: dict[str, Path] = {}

    @contextlib.contextmanager
    def stream(self, name: str) -> Iterator[BinaryIO]:
        if name not in self._copies:
            folder = tempfile.mkdtemp(prefix="hyjax-")
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            self._copies[name] = self._copy(name, folder)
        with _opened(self._copies[name], self.where(name)) as file:
            yield file

    def read(self, name: str) -> bytes:
        if name not in self:
            raise InputError(f"{self.where(name)}: no such file")
        try:
            with self._lock:
                return self._zip.read(name)
        except Exception as error:  # BadZipFile, OSError, zlib.error, lzma.LZMAError, …
            raise InputError(f"{self.where(name)}: damaged in the archive ({error})") from None

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="hyjax-") as folder:
            yield self._copy(name, folder)

    def _copy(self, name: str, folder: str) -> Path:
        """A copy of a file in a folder, made piece by piece."""
        if name not in self:
            raise InputError(f"{self.where(name)}: no such file")
        copy = Path(folder) / PurePosixPath(name).name
        try:
            with self._lock, self._zip.open(name) as packed, copy.open("wb") as file:
                shutil.copyfileobj(packed, file, 1 << 20)
        except Exception as error:  # as in `read`
            raise InputError(f"{self.where(name)}: damaged in the archive ({error})") from None
        return copy

    def size(self, name: str) -> int:
        return self._zip.getinfo(name).file_size

    def fingerprint(self) -> str:
        entries = (self._zip.getinfo(name) for name in self.names)
        return _digest(str(self.path.resolve()), (f"{e.filename} {e.file_size} {e.CRC}" for e in entries))


def _check_entry(path: Path, entry: zipfile.ZipInfo) -> None:
    """Raise `InputError` for an entry that no capture has."""
    name = entry.filename
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not name or "\0" in entry.orig_filename or name.startswith(("/", "\\")) or ".." in parts or ":" in parts[0]:
        raise InputError(f"{path}: refused, it holds a file named {name[:60]!r}, which leads out of the archive")
    if stat.S_ISLNK(entry.external_attr >> 16):
        raise InputError(f"{path}: refused, it holds a link, {name[:60]!r}")
    if entry.flag_bits & 1:
        raise InputError(f"{path}: {name[:60]!r} is encrypted; unpack the archive and give its folder")
    ratio = entry.file_size / max(entry.compress_size, 1)
    if entry.file_size > LARGEST_FILE or (entry.file_size > HARMLESS and ratio > LARGEST_RATIO):
        raise InputError(
            f"{path}: refused, {name[:60]!r} unpacks to {entry.file_size / 2**20:.0f} MiB from "
            f"{entry.compress_size / 2**20:.3g} MiB; unpack the archive yourself if you trust it"
        )


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
        return _digest(self._tree.fingerprint(), [self._top])


def open_tree(path: Path) -> FileTree:
    """The files of a folder, or of a ZIP archive (`.zip`, `.r3d`); a single file is a tree of one.

    Example:
        >>> import tempfile, pathlib
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> _ = (folder / "note.txt").write_text("two\\n")
        >>> open_tree(folder).text("note.txt")
        'two\\n'

    Raises:
        InputError: there is nothing at this path, or an archive that is damaged or not safe to open.
    """
    path = Path(path)
    if path.is_dir():
        return _Folder(path)
    if not path.is_file():
        raise InputError(f"{path}: no such folder; give the folder or the archive of a capture")
    if path.suffix.lower() in ARCHIVES:
        return _Archive(path)
    return _SingleFile(path)


class _SingleFile(_Folder):
    """One file of a folder, such as a `.sens`."""

    def __init__(self, path: Path) -> None:
        self._root = path.resolve().parent
        FileTree.__init__(self, path, [path.name])

    def where(self, name: str) -> str:
        return str(self.path)


def _digest(top: str, lines: Iterable[str]) -> str:
    return hashlib.sha256("\n".join([top, *lines]).encode()).hexdigest()
