"""Files that appear whole or not at all.

A file is written under a temporary name, brought to the disk, checked where its library does not tell that the disk
is full (`hyjax.util.whole_files`), and renamed. A process that is killed leaves at most temporary names, which the
next run in the same folder removes.
"""

import contextlib
import hashlib
import os
import platform
import re
import secrets
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NoReturn

from hyjax.util.errors import InputError
from hyjax.util.reading import disk_error
from hyjax.util.whole_files import check_whole

PART = ".part"
"""Before the suffix of a file, or after the name of a folder, that is not yet whole."""
OLD = ".old"
"""After the name of a folder that is being replaced."""
WINDOWS = os.name == "nt"
_HOST = re.sub(r"\W", "_", platform.node())[:32] or "host"
_RUN = secrets.token_hex(3)
"""Tells this process from an earlier one of the same id: a restarted container counts its processes anew."""
_TEMPORARY = re.compile(
    r"\.(?P<name>.+)\.(?P<host>\w+)-(?P<process>\d+)-(?P<run>\w+)-\d+(?P<kind>\.part|\.old)(\..*)?"
)


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` to write to: renamed to it if the block ends well and the file is whole.

    Raises:
        InputError: the file cannot be written, or is not whole: the disk is full. What was there before stays.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{_mark()}{PART}{path.suffix}")
    try:
        yield temporary
        _to_disk(temporary)
        check_whole(temporary, str(path))
        temporary.replace(path)
        _names_to_disk(path.parent)
    except Exception as error:
        _raise_for(error, path, temporary)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(out: Path, *, replace: bool = False) -> Iterator[Path]:
    """A temporary folder beside `out` to fill: renamed to it if the block ends well, removed if not.

    Args:
        out: the folder.
        replace: whether one that is there is replaced.

    Raises:
        InputError: `out` is there and neither to be replaced nor an empty folder, cannot be written, or a file in
            it is not whole.
    """
    out = Path(out)
    if not replace and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not an empty folder; choose another")
    temporary, old = (out.with_name(f".{out.name}.{_mark()}{kind}") for kind in (PART, OLD))
    try:
        remove_stale(out.parent)
        temporary.mkdir(parents=True)
        yield temporary
        for file in sorted(temporary.rglob("*")):
            if file.is_file():
                _to_disk(file)
                check_whole(file, str(out / file.relative_to(temporary)))
        if replace and out.exists():
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
    """Remove temporary files and folders that killed processes of this machine left in a folder.

    Those of processes that still run, and of other machines that share the folder, stay. A folder that was being
    replaced when its process was killed gets its name back.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            found = _TEMPORARY.fullmatch(entry.name)
            if found and found["host"] == _HOST and not _runs(int(found["process"]), found["run"]):
                path = Path(entry.path)
                if found["kind"] == OLD:
                    _clear(path, path.with_name(found["name"]))
                elif entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    remove(path)


def _clear(old: Path, out: Path) -> None:
    """Remove what was replaced, or put it back where nothing came in its place."""
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
    """Whether an error names a file that is not the written one, in it, beside it for its library, or around it."""
    named, path, temporary = named.absolute(), path.absolute(), temporary.absolute()
    own = str(named).startswith(str(temporary)) or named.is_relative_to(path) or path.is_relative_to(named)
    return not own


def _mark() -> str:
    """Whose temporary name it is: machine, process, its run, and thread."""
    return f"{_HOST}-{os.getpid()}-{_RUN}-{threading.get_ident()}"


def _runs(process: int, run: str) -> bool:
    if process == os.getpid():
        return run == _RUN
    if WINDOWS:  # signal 0 is Ctrl-C there
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # of another user
        return True
    return True


def _to_disk(path: Path) -> None:
    """Wait until the disk has a file (0.4 ms on a local one): some disks say only then that they are full."""
    # Windows does so for what may be written alone; elsewhere a file may be a copy that may not.
    descriptor = os.open(path, os.O_RDWR if WINDOWS else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _names_to_disk(folder: Path) -> None:
    """Wait until the disk has the names in a folder, where the system can: a power cut may undo a rename."""
    with contextlib.suppress(OSError):
        _to_disk(folder)


def remove(path: Path) -> None:
    """Remove a file if it is there.

    Raises:
        InputError: something is there that cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be replaced ({error.strerror or error})") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def append_line(path: Path, text: str) -> None:
    """Append a line to a file that is there: whole, or not at all.

    Raises:
        InputError: it cannot be written, as on a full disk.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
        try:
            append(descriptor, f"{text}\n".encode())
        finally:
            os.close(descriptor)
    except OSError as error:
        disk_error(path, error)


def append(descriptor: int, content: bytes) -> None:
    """Append to an open file of this process alone; what could only be written in part is taken back.

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


def make_writable(out: Path) -> None:
    """Make the output folder, or raise `InputError` if files cannot be written there.

    What killed processes left in it under temporary names is removed.
    """
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
        remove_stale(out)
    except OSError as error:
        raise InputError(f"{out}: cannot write there ({error.strerror}); choose another --out") from None


def digest(parts: Iterable[str]) -> str:
    """A short hash of some texts."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
