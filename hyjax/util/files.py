"""Files that appear whole or not at all.

A file is written under a temporary name, brought to the disk, and renamed. Who writes it checks that it is whole if
its library does not tell that the disk is full. A process that is killed leaves at most temporary names, which the
next run in the same folder removes: the system has locked them while their process lived.
"""

import contextlib
import errno
import functools
import hashlib
import os
import re
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NoReturn

from hyjax.util.claims import claimed, try_lock
from hyjax.util.errors import InputError
from hyjax.util.reading import disk_error

PART_SUFFIX = ".part"
"""Before the suffix of a file, or after the name of a folder, that is not yet whole."""
OLD_SUFFIX = ".old"
"""After the name of a folder that is being replaced."""
ON_WINDOWS = os.name == "nt"
_TEMPORARY = re.compile(r"\.(?P<name>.+)\.hyjax-[0-9a-f]{12}(?P<kind>\.part|\.old)(\..*)?")


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary name in the folder of `path` to write to, renamed to `path` if the block ends well."""
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{_mark()}{PART_SUFFIX}{path.suffix}")
    with contextlib.ExitStack() as held:
        try:
            _make_locked(held, temporary, temporary.touch)
            os.utime(temporary, (0, 0))
            yield temporary
            if (status := temporary.stat()).st_mtime_ns == status.st_size == 0:
                raise OSError(errno.EIO, "nothing was written")
            _to_disk(temporary)
            temporary.replace(path)
            _names_to_disk(path.parent)
        except Exception as error:
            _raise_for(error, path, temporary)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(out: Path, *, replace: bool = False) -> Iterator[Path]:
    """A temporary folder next to `out` to fill, renamed to `out` if the block ends well, else removed."""
    out = Path(out)
    if not replace and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not an empty folder; choose another")
    temporary, old = (out.with_name(f".{out.name}.{_mark()}{kind}") for kind in (PART_SUFFIX, OLD_SUFFIX))
    with contextlib.ExitStack() as held:
        try:
            remove_stale(out.parent)
            out.parent.mkdir(parents=True, exist_ok=True)
            _make_locked(held, temporary, functools.partial(temporary.mkdir, exist_ok=True))
            yield temporary
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _to_disk(file)
            if replace and out.exists():
                _lock(held, out)
                out.rename(old)
            elif out.is_dir():
                out.rmdir()
            temporary.rename(out)
            _names_to_disk(out.parent)
        except InputError as error:  # of a file in it
            raise InputError(str(error).replace(str(temporary), str(out))) from None
        except Exception as error:
            _raise_for(error, out, temporary)
        finally:
            _clear(old, out)
            shutil.rmtree(temporary, ignore_errors=True)


def remove_stale(folder: Path) -> None:
    """Remove temporary files and folders that killed processes left in a folder.

    Those of processes that still run stay, wherever they run: they are locked. So do all on file systems without
    locks, and on Windows. A folder that was being replaced when its process was killed gets its name back.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            found = _TEMPORARY.fullmatch(entry.name)
            with contextlib.suppress(OSError), contextlib.ExitStack() as held:
                path = Path(entry.path)
                if not found or _lock(held, path) is not True:
                    continue
                if found["kind"] == OLD_SUFFIX:
                    _clear(path, path.with_name(found["name"]))
                elif entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


MOST_TRIES = 100
"""Number of tries, 10 ms apart, to lock a new file."""


def _make_locked(held: contextlib.ExitStack, path: Path, make: Callable[[], None]) -> None:
    """Make a file or folder that is locked until the end; anew if `remove_stale` was there before the lock."""
    make()
    for _ in range(MOST_TRIES):
        if _lock(held, path) is not False and path.exists():
            return
        time.sleep(0.01)
        make()
    raise OSError(errno.EBUSY, "another process holds its lock", str(path))


def _lock(held: contextlib.ExitStack, path: Path) -> bool | None:
    """Whether a file or folder could be locked until the end; None where there are no locks."""
    if ON_WINDOWS:
        return None
    # NFS locks what may be written alone; a folder never may.
    flags = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_NOFOLLOW
    try:
        descriptor = os.open(path, flags)
    except FileNotFoundError:
        return False
    held.callback(os.close, descriptor)
    return try_lock(descriptor)


def _clear(old: Path, out: Path) -> None:
    """Remove a replaced folder, or put it back where nothing came in its place."""
    with contextlib.suppress(OSError):
        if old.exists() and not out.exists():
            old.rename(out)
    shutil.rmtree(old, ignore_errors=True)


def _raise_for(error: Exception, path: Path, temporary: Path) -> NoReturn:
    """Raise the `InputError` for an error of the disk, FFmpeg's among them, and any other as it is."""
    number = getattr(error, "errno", None)
    if isinstance(error, OSError):
        if isinstance(error.filename, str | os.PathLike) and _is_other(Path(error.filename), path, temporary):
            reason = error.strerror or error
            raise InputError(f"{error.filename}: cannot open ({reason}), which {path} needs") from None
        disk_error(path, error)
    if isinstance(number, int) and number > 0:
        disk_error(path, OSError(number, os.strerror(number)))
    raise error


def _is_other(named: Path, path: Path, temporary: Path) -> bool:
    """Whether an error names a file unrelated to the written one."""
    named, path, temporary = named.absolute(), path.absolute(), temporary.absolute()
    own = str(named).startswith(str(temporary)) or named.is_relative_to(path) or path.is_relative_to(named)
    return not own


def _mark() -> str:
    return f"hyjax-{secrets.token_hex(6)}"


def _to_disk(path: Path) -> None:
    """Wait until the disk has a file (0.4 ms on a local one): some disks say only then that they are full."""
    # Windows does so for what may be written alone; elsewhere a file may be a copy that may not.
    descriptor = os.open(path, os.O_RDWR if ON_WINDOWS else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _names_to_disk(folder: Path) -> None:
    """Wait until the disk has the names in a folder, where the system can: a power cut may undo a rename."""
    with contextlib.suppress(OSError):
        _to_disk(folder)


def remove(path: Path) -> None:
    """Remove a file if it is there."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be replaced ({error.strerror or error})") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def append_line(path: Path, text: str) -> None:
    """Append a line to a file that is there: whole, or not at all."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
        try:
            append(descriptor, f"{text}\n".encode())
        finally:
            os.close(descriptor)
    except OSError as error:
        disk_error(path, error)


def append(descriptor: int, content: bytes) -> None:
    """Append to an open file of this process alone; a partial write is taken back.

    Raises:
        OSError: it cannot be written.
    """
    end = os.fstat(descriptor).st_size
    try:
        while content:
            content = content[os.write(descriptor, content) :]
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(descriptor, end)
        raise


def is_file(path: str | Path) -> bool:
    """Whether there is such a file; a name that none can have is no error.

    >>> is_file("x" * 10_000)
    False
    """
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def make_writable(out: Path) -> list[Path]:
    """Make the output folder, or raise `InputError` if files cannot be written there.

    What killed processes left in it under temporary names is removed.

    Returns:
        Folders that were made for it, the innermost first.
    """
    made, out = list[Path](), Path(out)
    try:
        made = [folder for folder in (out, *out.parents) if not folder.exists()]
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
        remove_stale(out)
    except OSError as error:
        _remove_empty(made)
        reason = "it is a file, not a folder" if is_file(out) else error.strerror
        raise InputError(f"{out}: cannot write there ({reason}); choose another --out") from None
    return made


@contextlib.contextmanager
def output_folder(out: Path) -> Iterator[None]:
    """Output folder for this process alone, see `make_writable` and `claimed`.

    Folders that are made for it and stay empty, as where all is refused, are removed again.
    """
    made = make_writable(out)
    with claimed(out):
        try:
            yield
        finally:
            _remove_empty(made)


def _remove_empty(folders: Iterable[Path]) -> None:
    with contextlib.suppress(OSError):  # of the first that is not empty, or not there
        for folder in folders:
            folder.rmdir()


def digest(parts: Iterable[str]) -> str:
    """A short hash of some texts."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
