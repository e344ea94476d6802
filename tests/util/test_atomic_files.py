"""Temporary names and the order of disk operations behind files that appear whole."""

import os
from pathlib import Path

import pytest

from hyjax.util import files
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, new_folder, remove_stale, write_text


def left_by(process: int, folder: Path, run: str | None = None) -> Path:
    """A temporary file as a killed process of this machine leaves it."""
    with atomic_write(folder / "a.txt") as temporary:
        temporary.write_text("")
    host, _, own_run, rest = temporary.name.rsplit("-", 3)
    left = folder / f"{host}-{process}-{run or own_run}-{rest}"
    left.write_text("half")
    return left


def test_what_an_earlier_process_of_the_same_id_left_is_removed(tmp_path: Path) -> None:
    old, own = left_by(os.getpid(), tmp_path, "000000"), left_by(os.getpid(), tmp_path)
    remove_stale(tmp_path)
    assert own.exists() and not old.exists()


def test_a_number_that_no_process_has(tmp_path: Path) -> None:
    left = left_by(10**30, tmp_path)
    remove_stale(tmp_path)
    assert not left.exists()


def test_no_process_is_asked_on_windows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = left_by(999_999_999, tmp_path)
    monkeypatch.setattr(files, "WINDOWS", True)
    monkeypatch.setattr(os, "kill", lambda *_: pytest.fail("ended a process"))
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

    monkeypatch.setattr(files, "WINDOWS", True)
    monkeypatch.setattr(os, "open", opened)
    write_text(tmp_path / "a.txt", "whole")
    assert flags[0] & os.O_RDWR and (tmp_path / "a.txt").read_text() == "whole"


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
