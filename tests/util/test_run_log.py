"""Run logs: what a crash cut off, what is refused, when the file is written."""

from pathlib import Path

import pytest

from hyjax.util.errors import InputError
from hyjax.util.run_log import RunLog, as_json, check_same_settings, read_lines


def read(path: Path) -> list[dict]:
    return read_lines(path, lambda line: "k" in line, "a line with k")


def filled(path: Path, count: int = 3) -> RunLog:
    log = RunLog(path)
    for k in range(count):
        log.add({"k": k})
    return log


def test_every_line_is_on_disk_at_once(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    log = RunLog(path, [{"k": "header"}])
    assert not path.exists(), "a run that was refused blocks no folder"
    for k in range(3):
        log.add({"k": k})
        assert read(path) == log.lines == [{"k": "header"}, *({"k": i} for i in range(k + 1))]


def test_cutting_anywhere_loses_one_line_at_most_and_the_next_line_repairs_it(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    filled(path)
    content = path.read_bytes()
    ends = [i for i, byte in enumerate(content) if byte == ord("\n")]
    for length in range(len(content) + 1):
        path.write_bytes(content[:length])
        whole = [{"k": k} for k in range(sum(end <= length for end in ends))]
        assert read(path) == whole
        RunLog(path, read(path)).add({"k": 9})
        assert read(path) == [*whole, {"k": 9}]


@pytest.mark.parametrize("broken", ["{", "[1]", '{"other": 1}', "", "null"])
def test_a_broken_line_before_the_last_is_refused(broken: str, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(f'{{"k": 0}}\n{broken}\n{{"k": 2}}\n')
    with pytest.raises(InputError, match=r"log\.jsonl: line 2 is not a line with k; remove it or the file$"):
        read(path)


def test_without_a_file_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    log = RunLog(None)
    log.add({"k": 1})
    log.write()
    assert log.lines == [{"k": 1}] and not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write"):
        filled(tmp_path / "none" / "log.jsonl")
    log = filled(tmp_path / "log.jsonl")
    (tmp_path / "log.jsonl").unlink()
    (tmp_path / "log.jsonl").mkdir()
    with pytest.raises(InputError, match=r"log\.jsonl: cannot write"):
        log.add({"k": 3})
    with pytest.raises(InputError, match=r"log\.jsonl: is a folder"):
        read(tmp_path / "log.jsonl")


def test_other_settings_are_named(tmp_path: Path) -> None:
    before = as_json({"seed": 0, "frames": (0, 3), "size": None})
    check_same_settings(tmp_path, before, as_json({"seed": 0, "frames": [0, 3], "size": None}))
    with pytest.raises(
        InputError, match="cannot resume, that run had seed 0 and this one has 1; give the same"
    ) as e:
        check_same_settings(tmp_path, before, before | {"seed": 1, "size": 3})
    assert "\n" not in str(e.value)
    check_same_settings(tmp_path, before, before | {"seed": 1}, ignored=("seed",))
    with pytest.raises(InputError, match="that run had no --new and this one has --new 2"):
        as_option = {None: "no --new", 2: "--new 2"}
        check_same_settings(tmp_path, before, before | {"new": 2}, option=lambda name, value: as_option[value])
