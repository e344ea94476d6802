"""What a run has computed survives its end, whenever that comes."""

import math
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyjax import InputError
from hyjax.tuning.journal import NAME, Journal, check_free

SETTINGS: dict[str, Any] = {"seed": 0, "frames": [0, 3], "size": None, "lights": "Point(position=(1, 2, 3))"}


def forbidden() -> None:
    raise AssertionError("computed again")


def filled(folder: Path) -> Path:
    journal = Journal(folder, SETTINGS)
    journal.remember("a", lambda: 1.5)
    journal.remember("b", lambda: [[0.1, 0.2], 3])
    return folder / NAME


def test_computes_each_key_once(tmp_path: Path) -> None:
    for folder in (tmp_path, None):
        journal, calls = Journal(folder, SETTINGS), []
        for _ in range(3):
            assert journal.remember("key", lambda calls=calls: calls.append(1) or 0.5) == 0.5
        assert journal.remember("other", lambda: None) is None and journal.remember("other", forbidden) is None
        assert len(calls) == 1


def test_in_memory_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Journal(None, SETTINGS).remember("a", lambda: 1)
    Journal(None, SETTINGS, resume=True).remember("a", lambda: 2)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text",
    [
        '{"settings": [1]}\n{"key": "a", "value": 2}\n',
        '{"settings": {}}\n{"key": [1], "value": 2}\n{"key": "a", "value": 2}\n',
        '{"settings": {}}\n{"key": "a"}\n{"key": "a", "value": 2}\n',
        '{"key": "a", "value": 2}\n',
        '{"settings": {}}\n{"settings": {}}\n',
        "[" * 100_000 + "\n{}\n",
        f'{{"settings": {{}}, "x": {"9" * 5000}}}\n{{}}\n',
    ],
)
def test_a_journal_of_something_else_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / NAME).write_text(text)
    with pytest.raises(InputError, match=NAME):
        Journal(tmp_path, SETTINGS, resume=True)


def test_resumes(tmp_path: Path) -> None:
    filled(tmp_path)
    again = Journal(tmp_path, SETTINGS, resume=True)
    assert again.remember("a", forbidden) == 1.5 and again.remember("b", forbidden) == [[0.1, 0.2], 3]
    again.remember("c", lambda: "new")
    third = Journal(tmp_path, SETTINGS, resume=True)
    assert [third.remember(key, forbidden) for key in "abc"] == [1.5, [[0.1, 0.2], 3], "new"]


def test_every_result_is_on_disk_at_once(tmp_path: Path) -> None:
    journal = Journal(tmp_path, SETTINGS)
    for k in range(3):
        journal.remember(str(k), lambda k=k: k)
        assert len((tmp_path / NAME).read_text().splitlines()) == k + 2


def test_an_exception_while_computing_leaves_no_entry(tmp_path: Path) -> None:
    journal = Journal(tmp_path, SETTINGS)
    with pytest.raises(AssertionError):
        journal.remember("a", forbidden)
    assert journal.remember("a", lambda: 2) == 2
    assert Journal(tmp_path, SETTINGS, resume=True).remember("a", forbidden) == 2


@settings(max_examples=100)
@given(st.lists(st.floats(allow_nan=False), max_size=4))
def test_floats_come_back_as_they_were(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    folder = tmp_path_factory.mktemp("journal")
    first = Journal(folder, SETTINGS).remember("key", lambda: values)
    again = Journal(folder, SETTINGS, resume=True).remember("key", forbidden)
    for got in (first, again):
        assert [struct.pack("d", x) for x in got] == [struct.pack("d", x) for x in values]


def test_a_loss_that_is_not_a_number_comes_back(tmp_path: Path) -> None:
    Journal(tmp_path, SETTINGS).remember("key", lambda: [math.nan, math.inf])
    got = Journal(tmp_path, SETTINGS, resume=True).remember("key", forbidden)
    assert math.isnan(got[0]) and got[1] == math.inf


def test_a_run_that_was_not_interrupted_gets_the_same_types(tmp_path: Path) -> None:
    assert Journal(None, SETTINGS).remember("key", lambda: (1, (2.0,))) == [1, [2.0]]


@pytest.mark.parametrize("cut", range(1, 24))
def test_a_torn_last_line_is_ignored(cut: int, tmp_path: Path) -> None:
    path = filled(tmp_path)
    path.write_bytes(path.read_bytes()[:-cut])
    again = Journal(tmp_path, SETTINGS, resume=True)
    assert again.remember("a", forbidden) == 1.5
    if cut > 1:  # else only the line's end is missing
        assert again.remember("b", lambda: "again") == "again"
    again.remember("c", lambda: 7)
    third = Journal(tmp_path, SETTINGS, resume=True)
    assert third.remember("a", forbidden) == 1.5 and third.remember("c", forbidden) == 7


@pytest.mark.parametrize("junk", [b"\xff\xfe\x00", b"[1]\n", b'{"key": 1}\n', b"null\n", b'"text"\n', b"\n"])
def test_junk_at_the_end_is_ignored(junk: bytes, tmp_path: Path) -> None:
    path = filled(tmp_path)
    path.write_bytes(path.read_bytes() + junk)
    again = Journal(tmp_path, SETTINGS, resume=True)
    assert again.remember("a", forbidden) == 1.5 and again.remember("b", forbidden) == [[0.1, 0.2], 3]
    again.remember("c", lambda: 7)
    assert Journal(tmp_path, SETTINGS, resume=True).remember("c", forbidden) == 7


@pytest.mark.parametrize("head", [b"", b'{"sett'])
def test_a_run_killed_at_its_very_beginning_resumes(head: bytes, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(head)
    assert Journal(tmp_path, SETTINGS, resume=True).remember("a", lambda: 1) == 1
    assert Journal(tmp_path, SETTINGS, resume=True).remember("a", forbidden) == 1


def test_a_kill_while_resuming_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is written anew with the first new entry; until the new one is whole the old one has to stay."""
    path = filled(tmp_path)
    whole = Path.write_text

    def torn(self: Path, text: str, **options: Any) -> int:
        whole(self, text[: len(text) // 2], **options)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", torn)
        with pytest.raises(KeyboardInterrupt):
            Journal(tmp_path, SETTINGS, resume=True).remember("c", lambda: 7)
    again = Journal(tmp_path, SETTINGS, resume=True)
    assert path.exists() and again.remember("a", forbidden) == 1.5
    assert again.remember("b", forbidden) == [[0.1, 0.2], 3]


def test_resume_in_an_empty_folder_starts(tmp_path: Path) -> None:
    assert Journal(tmp_path, SETTINGS, resume=True).remember("a", lambda: 1) == 1
    assert Journal(tmp_path, SETTINGS, resume=True).remember("a", forbidden) == 1


@pytest.mark.parametrize(
    ("key", "value"), [("seed", 1), ("frames", [0]), ("size", [64, 64]), ("lights", ""), ("new", 1)]
)
def test_other_settings_are_refused(key: str, value: Any, tmp_path: Path) -> None:
    before = filled(tmp_path).read_bytes()
    with pytest.raises(
        InputError, match=f"^{tmp_path}: cannot resume, that run had {key} .* and this one has "
    ) as e:
        Journal(tmp_path, SETTINGS | {key: value}, resume=True)
    assert "\n" not in str(e.value) and (tmp_path / NAME).read_bytes() == before
    Journal(tmp_path, SETTINGS | {"frames": (0, 3)}, resume=True)  # JSON has no tuples: no other settings


def test_another_runs_folder_is_refused(tmp_path: Path) -> None:
    before = filled(tmp_path).read_bytes()
    for act in (lambda: Journal(tmp_path, SETTINGS), lambda: check_free(tmp_path, False)):
        with pytest.raises(InputError, match=f"^{tmp_path}: holds the results of another run; add --resume"):
            act()
    assert (tmp_path / NAME).read_bytes() == before
    check_free(tmp_path, True)
    check_free(tmp_path / "none", False)


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        Journal(tmp_path / "none", SETTINGS).remember("a", lambda: 1)


def test_a_folder_that_goes_away_amid_a_run(tmp_path: Path) -> None:
    path = filled(tmp_path)
    journal = Journal(tmp_path, SETTINGS, resume=True)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="cannot write"):
        journal.remember("c", lambda: 1)


def test_without_results_it_blocks_nothing(tmp_path: Path) -> None:
    """A run that was refused before it found anything can be given again, with other options."""
    Journal(tmp_path, SETTINGS)
    assert not list(tmp_path.iterdir())
    assert Journal(tmp_path, SETTINGS | {"seed": 1}).remember("a", lambda: 1) == 1
