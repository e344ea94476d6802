"""Rows of results: what each carries, what becomes of interrupted runs, and the commit."""

import dataclasses
import json
import math
import os
import shutil
import subprocess
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.records import FILE, ROOT, Results, is_finished, read_rows
from hyjax.util import claims
from hyjax.util.checkout import commit
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class Config:
    size: tuple[int, int] = (128, 128)
    kappa: float = 0.03
    capture: Path | None = None
    seed: int = 7
    out: Path = Path("anywhere")
    resume: bool = False


def start(folder: Path, config: Config | None = None, *, resume: bool = False) -> Results:
    return Results(folder, "some_experiment", config or Config(), resume=resume)


def interrupted(folder: Path, rows: int = 3) -> None:
    results = start(folder)
    for k in range(rows):
        results.add(kind="score", k=k)


def refusal(folder: Path, config: Config | None = None, *, resume: bool = False) -> str:
    before = (folder / FILE).read_bytes()
    with pytest.raises(InputError) as caught:
        start(folder, config, resume=resume)
    assert (folder / FILE).read_bytes() == before
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_row_says_what_it_takes_to_make_it_again(tmp_path: Path) -> None:
    results = start(tmp_path, Config(capture=Path("some/room")))
    results.add(kind="score", loss=0.5)
    returned = results.finish()
    rows = read_rows(tmp_path / FILE)
    assert rows == returned and len(rows) == 2
    for row in rows:
        assert row["experiment"] == "some_experiment"
        assert row["settings"] == {"size": [128, 128], "kappa": 0.03, "capture": "some/room", "seed": 7}
        assert row["seed"] == 7 and row["commit"] == commit(ROOT)
        assert row["device"].startswith("cpu") and row["cpu_count"] == os.cpu_count()
        assert {"hyjax", "python", "jax", "numpy"} <= row["versions"].keys()
    assert rows[0]["loss"] == 0.5
    assert rows[1]["kind"] == "finished" and rows[1]["peak_memory_mib"] > 0


def test_values_become_plain_json(tmp_path: Path) -> None:
    results = start(tmp_path)
    results.add(
        nan=math.nan,
        inside={"inf": [1.0, -math.inf], 3: np.float32("nan")},
        array=np.array([[1.0, np.inf]]),
        traced=jnp.arange(2),
        flag=np.bool_(True),
        path=Path("a/b"),
        none=None,
    )
    (row,) = read_rows(tmp_path / FILE)
    assert row["nan"] is None and row["inside"] == {"inf": [1.0, None], "3": None}
    assert row["array"] == [[1.0, None]] and row["traced"] == [0, 1]
    assert row["flag"] is True and row["path"] == "a/b" and row["none"] is None
    assert "NaN" not in (tmp_path / FILE).read_text() and "Infinity" not in (tmp_path / FILE).read_text()


def test_a_value_cannot_hide_the_stamp(tmp_path: Path) -> None:
    results = start(tmp_path)
    with pytest.raises(ValueError, match="'seed'"):
        results.add(kind="score", seed=3)
    assert results.rows == [] and not (tmp_path / FILE).exists()


def test_a_last_line_cut_off_by_a_crash_is_left_out(tmp_path: Path) -> None:
    interrupted(tmp_path)
    path = tmp_path / FILE
    content = path.read_bytes()
    path.write_bytes(content + content.splitlines()[0][:40])
    assert [row["k"] for row in read_rows(path)] == [0, 1, 2]
    start(tmp_path, resume=True).add(kind="score", k=3)
    assert [row["k"] for row in read_rows(path)] == [0, 1, 2, 3]


def test_cutting_anywhere_loses_one_row_at_most(tmp_path: Path) -> None:
    interrupted(tmp_path)
    path = tmp_path / FILE
    content = path.read_bytes()
    ends = [i for i, byte in enumerate(content) if byte == ord("\n")]
    for length in {*range(0, len(content), 97), *ends, *(end + 1 for end in ends)}:
        path.write_bytes(content[:length])
        assert [row["k"] for row in read_rows(path)] == list(range(sum(end <= length for end in ends)))


@pytest.mark.parametrize("line", ["{", "[1, 2]", '{"loss": 1}', ""])
def test_a_broken_line_amid_the_file_is_refused(tmp_path: Path, line: str) -> None:
    interrupted(tmp_path)
    first, *rest = (tmp_path / FILE).read_text().splitlines()
    (tmp_path / FILE).write_text("\n".join([first, line, *rest]) + "\n")
    with pytest.raises(InputError, match="line 2 is not a row of results"):
        read_rows(tmp_path / FILE)
    assert "line 2" in refusal(tmp_path, resume=True)


def test_no_file_to_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"{FILE}: no such file"):
        read_rows(tmp_path / FILE)


def test_an_interrupted_run_is_not_overwritten(tmp_path: Path) -> None:
    interrupted(tmp_path)
    message = refusal(tmp_path)
    assert str(tmp_path) in message and "3 rows" in message and "--resume" in message and "--out" in message


def test_a_refused_run_keeps_no_claim(tmp_path: Path) -> None:
    interrupted(tmp_path)
    with pytest.raises(InputError) as kept:  # with the frames of the refused call
        start(tmp_path)
    assert kept.tb is not None and (tmp_path.stat().st_dev, tmp_path.stat().st_ino) not in claims._held


def test_no_resume_is_offered_where_there_is_none(tmp_path: Path) -> None:
    @dataclasses.dataclass(frozen=True)
    class Plain:
        size: int = 128

    Results(tmp_path, "some_experiment", Plain()).add(kind="score")
    with pytest.raises(InputError, match=f"remove its {FILE}, or choose another --out") as caught:
        Results(tmp_path, "some_experiment", Plain())
    assert "--resume" not in str(caught.value)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (Config(kappa=0.05), "kappa 0.03 and this one has 0.05"),
        (Config(size=(128, 256)), "size [128, 128] and this one has [128, 256]"),
        (Config(capture=Path("room")), "capture None and this one has 'room'"),
        (Config(seed=8), "seed 7 and this one has 8"),
    ],
)
def test_resuming_with_other_settings_is_refused(tmp_path: Path, other: Config, said: str) -> None:
    interrupted(tmp_path)
    assert said in refusal(tmp_path, other, resume=True)


def test_resuming_another_experiment_is_refused(tmp_path: Path) -> None:
    interrupted(tmp_path)
    with pytest.raises(InputError, match="experiment 'some_experiment' and this one has 'other'"):
        Results(tmp_path, "other", Config(), resume=True)


def test_resuming_goes_on(tmp_path: Path) -> None:
    interrupted(tmp_path)
    results = start(tmp_path, Config(out=tmp_path, resume=True), resume=True)
    assert [row["k"] for row in results.rows] == [0, 1, 2]
    results.add(kind="score", k=3)
    results.finish()
    rows = read_rows(tmp_path / FILE)
    assert [row.get("k") for row in rows] == [0, 1, 2, 3, None] and is_finished(rows)


def test_resuming_a_finished_run_opens_it_again(tmp_path: Path) -> None:
    results = start(tmp_path)
    results.add(kind="score", k=0)
    results.finish()
    again = start(tmp_path, resume=True)
    again.add(kind="score", k=1)
    assert not is_finished(read_rows(tmp_path / FILE))
    assert [row["kind"] for row in again.finish()] == ["score", "score", "finished"]


def test_resuming_nothing_starts(tmp_path: Path) -> None:
    results = start(tmp_path / "new", resume=True)
    results.add(kind="score", k=0)
    assert results.rows == read_rows(tmp_path / "new" / FILE)


def test_a_finished_run_is_replaced_with_the_first_row(tmp_path: Path) -> None:
    results = start(tmp_path)
    results.add(kind="score", k=0)
    results.finish()
    again = start(tmp_path, Config(kappa=0.05))
    assert again.rows == [] and is_finished(read_rows(tmp_path / FILE))
    again.add(kind="score", k=1)
    assert [row["k"] for row in read_rows(tmp_path / FILE)] == [1]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write there"):
        start(tmp_path / "file")
    (tmp_path / FILE).mkdir()
    with pytest.raises(InputError, match=f"{FILE}: cannot write"):
        start(tmp_path).add(kind="score")


def test_a_folder_that_goes_away(tmp_path: Path) -> None:
    results = start(tmp_path / "run")
    results.add(kind="score")
    (tmp_path / "run" / FILE).unlink()
    (tmp_path / "run").rmdir()
    with pytest.raises(InputError, match=f"{FILE}: cannot write"):
        results.add(kind="score")


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org")
    done = subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.mark.skipif(shutil.which("git") is None, reason="no git here")
def test_the_commit_of_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert commit(tmp_path) == "unknown"
    git(tmp_path, "init", "--quiet")
    assert commit(tmp_path) == "unknown"  # nothing committed
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "--quiet", "--message", "one")
    head = git(tmp_path, "rev-parse", "HEAD")
    assert len(head) == 40 and commit(tmp_path) == head
    (tmp_path / "untracked").write_text("of no account")
    assert commit(tmp_path) == head
    (tmp_path / "file").write_text("two")
    assert commit(tmp_path) == f"{head}-dirty"
    monkeypatch.setenv("PATH", "")
    assert commit(tmp_path) == "unknown"  # no git at all


def test_rows_are_lines_of_json(tmp_path: Path) -> None:
    interrupted(tmp_path, 2)
    lines = (tmp_path / FILE).read_text().splitlines()
    assert [json.loads(line)["k"] for line in lines] == [0, 1]
