"""File tree of a path: of a folder, an archive, or a single file."""

import contextlib
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

from hyjax.data.archive import ARCHIVES, MOST_FILES, Archive
from hyjax.data.file_tree import IGNORED, FileTree
from hyjax.util.errors import InputError, did_you_mean

MOST_BESIDE = 1000
"""Most names beside a missing folder that are looked at for the one that was meant."""


def open_tree(path: Path) -> FileTree:
    """The files of a folder, or of a ZIP archive (`.zip`, `.r3d`); a single file is a tree of one.

    Example:
        >>> import tempfile, pathlib
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> _ = (folder / "note.txt").write_text("two\\n")
        >>> open_tree(folder).text("note.txt")
        'two\\n'
    """
    path = Path(path)
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except OSError:  # a name that no file can have
        is_folder = is_file = False
    if is_folder:
        return _folder(path)
    if not is_file:
        raise InputError(f"{path}: no such folder{_nearest(path)}; give the folder or the archive of a capture")
    if path.suffix.lower() in ARCHIVES:
        return Archive(path)
    return SingleFile(path)


def _nearest(path: Path) -> str:
    """Hint at the name beside a path that is nearest to its own."""
    try:
        beside = [entry.name for entry in itertools.islice(path.parent.iterdir(), MOST_BESIDE)]
    except OSError:
        return ""
    return did_you_mean(path.name, beside)


def _folder(path: Path) -> FileTree:
    """Links below the folder are followed, to folders too; the user has put them there."""
    names = list(itertools.islice(_walk(path.resolve()), MOST_FILES + 1))
    if len(names) > MOST_FILES:
        raise InputError(f"{path}: holds over {MOST_FILES} files; give the folder of one capture")
    return FileTree(path, names)


def _walk(root: Path) -> Iterator[str]:
    """Names of the files below a folder. A link to a folder above it, which would never end, is left out."""
    left: list[tuple[str, tuple[str, ...]]] = [("", ())]
    while left:
        top, above = left.pop()
        real = os.path.realpath(root / top)
        try:
            entries = [] if real in above else sorted(os.scandir(root / top), key=lambda entry: entry.name)
        except OSError as error:
            if not top:
                raise InputError(f"{root}: cannot read ({error.strerror})") from None
            continue
        for entry in entries:
            if entry.name in IGNORED:
                continue
            with contextlib.suppress(OSError):  # a link that leads nowhere
                if entry.is_dir():
                    left.append((f"{top}{entry.name}/", (*above, real)))
                elif entry.is_file():  # no pipe or device
                    yield top + entry.name


class SingleFile(FileTree):
    """One file of a folder, such as a `.sens`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, [path.name])
        self._root = self._root.parent

    def where(self, name: str) -> str:
        return str(self.path)
