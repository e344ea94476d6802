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
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

from hyjax.util.errors import InputError
from hyjax.util.reading import disk_error
from hyjax.util.whole_files import check_whole

PART = ".part"
"""Before the suffix of a file, or after the name of a folder, that is not yet whole."""
_HOST = re.sub(r"\W", "_", platform.node())[:32] or "host"
_TEMPORARY = re.compile(rf"\..+\.(?P<host>\w+)-(?P<process>\d+)-\d+{re.escape(PART)}(\..*)?")


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
    except OSError as error:
        disk_error(path, error)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out` to fill: renamed to it if the block ends well, removed if not.

    Raises:
        InputError: `out` is there and not an empty folder, or cannot be written.
    """
    out = Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not an empty folder; choose another")
    temporary = out.with_name(f".{out.name}.{_mark()}{PART}")
    try:
        remove_stale(out.parent)
        temporary.mkdir(parents=True)
        yield temporary
        if out.is_dir():
            out.rmdir()
        temporary.rename(out)
    except OSError as error:
        disk_error(out, error)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_stale(folder: Path) -> None:
    """Remove temporary files and folders that killed processes of this machine left in a folder.

    Those of processes that still run, and of other machines that share the folder, stay.
    """
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            found = _TEMPORARY.fullmatch(entry.name)
            if found and found["host"] == _HOST and not _runs(int(found["process"])):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    remove(Path(entry.path))


def _mark() -> str:
    """Whose temporary name it is: machine, process and thread."""
    return f"{_HOST}-{os.getpid()}-{threading.get_ident()}"


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True


def _to_disk(path: Path) -> None:
    """Wait until the disk has a file (0.4 ms on a local one): some disks say only then that they are full."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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


def make_writable(out: Path) -> None:
    """Make the output folder, or raise `InputError` if files cannot be written there.

    What killed processes left in it under temporary names is removed.
    """
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
