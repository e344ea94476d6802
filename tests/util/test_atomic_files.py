"""Temporary names and the order of disk operations behind files that appear whole."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hyjax.util import files
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, new_folder, output_folder, remove_stale, write_text

WRITER = """
import sys
from pathlib import Path
from hyjax.util.files import atomic_write, new_folder
write = {"file": atomic_write, "folder": new_folder}[sys.argv[1]]
with write(Path(sys.argv[2])) as temporary:
    temporary.write_text("half") if sys.argv[1] == "file" else (temporary / "a.txt").write_text("half")
    print(temporary, flush=True)
    sys.stdin.read()
"""


def test_an_output_folder_that_stays_empty_goes_again_with_those_made_for_it(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
        raise ZeroDivisionError
    assert not (tmp_path / "a").exists() and tmp_path.is_dir()


@pytest.mark.parametrize("before", ["empty", "with a file"])
def test_an_output_folder_that_was_there_stays(before: str, tmp_path: Path) -> None:
    if before == "with a file":
        (tmp_path / "mine.txt").write_text("mine")
    with output_folder(tmp_path):
        pass
    assert tmp_path.is_dir() and len(list(tmp_path.iterdir())) == (before == "with a file")


def test_an_output_folder_with_a_file_stays(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), output_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "one.png").write_text("")
        raise ZeroDivisionError
    assert (tmp_path / "a" / "b" / "one.png").is_file()


def test_an_output_folder_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.tempfile, "TemporaryFile", full)
    with pytest.raises(InputError, match="cannot write there"), output_folder(tmp_path / "a"):
        pass
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_being_written_stays_until_its_process_is_dead(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever process numbers say: another container that shares the folder has others."""

    def unknown(*_: int) -> None:
        raise ProcessLookupError

    command = [sys.executable, "-c", WRITER, kind, str(tmp_path / "a.txt")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as other:  # type: ignore[call-overload]
        temporary = Path(other.stdout.readline().strip())
        with monkeypatch.context() as another:
            another.setattr(os, "kill", unknown)
            remove_stale(tmp_path)
        assert temporary.exists() and temporary.parent == tmp_path
        other.kill()
        other.wait()
    assert temporary.exists()
    remove_stale(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_being_replaced_keeps_its_other_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While its process lives, nobody gives the old one its name back."""
    (tmp_path / "a").mkdir()
    actual = Path.rename

    def renamed(self: Path, target: Path) -> Path:
        result = actual(self, target)
        remove_stale(tmp_path)
        return result

    monkeypatch.setattr(Path, "rename", renamed)
    with new_folder(tmp_path / "a", replace=True) as folder:
        (folder / "new.txt").write_text("")
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "new.txt"]


def test_what_is_removed_before_it_is_locked_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    actual, times = files._lock, [0]

    def late(held: contextlib.ExitStack, path: Path) -> bool | None:
        times[0] += 1
        if times[0] == 1:
            path.unlink()
        return actual(held, path)

    monkeypatch.setattr(files, "_lock", late)
    with atomic_write(tmp_path / "a.txt") as temporary:
        assert temporary.exists()
        remove_stale(tmp_path)
        temporary.write_text("whole")
    assert (tmp_path / "a.txt").read_text() == "whole" and times[0] == 3


def test_nothing_is_removed_where_there_are_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = tmp_path / ".a.hyjax-0123456789ab.part.txt"
    left.write_text("half")
    monkeypatch.setattr(files, "try_lock", lambda _: None)
    remove_stale(tmp_path)
    assert left.exists()
    monkeypatch.setattr(files, "ON_WINDOWS", True)
    monkeypatch.setattr(files, "try_lock", lambda _: pytest.fail("asked for a lock"))
    remove_stale(tmp_path)
    assert left.exists()


def test_files_are_synchronised_through_descriptors_that_may_write_on_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flags: list[int] = []
    actual = os.open

    def opened(path: Path, flag: int, *more: int) -> int:
        flags.append(flag)
        return actual(path, flag, *more)

    monkeypatch.setattr(files, "ON_WINDOWS", True)
    monkeypatch.setattr(os, "open", opened)
    write_text(tmp_path / "a.txt", "whole")
    assert flags[1] & os.O_RDWR and (tmp_path / "a.txt").read_text() == "whole"


def test_a_copy_that_may_not_be_written_is_synchronised_too(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
        temporary.chmod(0o444)
    assert (tmp_path / "a.txt").read_text() == "whole"


def test_a_rename_is_followed_by_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[bool] = []
    monkeypatch.setattr(os, "fsync", lambda file: done.append(os.path.samestat(os.fstat(file), tmp_path.stat())))
    write_text(tmp_path / "a.txt", "whole")
    assert done == [False, True]
    with new_folder(tmp_path / "b"):
        pass
    assert done == [False, True, True]


def test_a_missing_input_is_not_called_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    missing = tmp_path / "missing.txt"
    said = "missing.txt: cannot open .No such file or directory., which .*out.txt needs"
    with pytest.raises(InputError, match=said), atomic_write(tmp_path / "out.txt") as temporary:
        temporary.write_text(missing.read_text())
    with pytest.raises(InputError, match=said), new_folder(tmp_path / "out.txt") as folder:
        (folder / "a").write_text(missing.read_text())
    with pytest.raises(InputError, match="cannot write"), new_folder(tmp_path / "out.txt") as folder:
        (folder / "none" / "a").write_text("")
    with (
        pytest.raises(InputError, match="cannot write"),
        atomic_write(tmp_path / "none" / "out.txt") as temporary,
    ):
        temporary.write_text("")
    assert not list(tmp_path.iterdir())


def test_a_block_that_writes_nothing_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write .nothing was written"), atomic_write(tmp_path / "file"):
        pass
    assert not list(tmp_path.iterdir())
    with atomic_write(tmp_path / "empty") as part:
        part.write_bytes(b"")
    assert (tmp_path / "empty").read_bytes() == b""
