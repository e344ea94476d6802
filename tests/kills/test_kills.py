"""Commands that are killed, and two that write to one folder; `python -m tests.kills` does more of it."""

import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kills.commands import COMMANDS
from kills.harness import Killer, damages


@pytest.fixture(scope="module")
def killer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killer]:
    yield Killer(tmp_path_factory.mktemp("kills"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["relight", "convert"])
def test_killed_runs_come_to_the_same(name: str, killer: Killer) -> None:
    outcome = killer.kill(COMMANDS[name], 2)
    assert outcome.kills == 2 and outcome.finished >= 1
    assert not outcome.wrong


@pytest.mark.slow
@pytest.mark.parametrize("name", ["relight", "convert"])
def test_two_runs_into_one_folder(name: str, killer: Killer) -> None:
    assert not killer.together(COMMANDS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["relight", "convert"])
def test_a_full_disk_is_a_line_and_leaves_whole_files(name: str, killer: Killer) -> None:
    assert not killer.fill(COMMANDS[name], 2)


@pytest.mark.slow
def test_a_folder_that_vanishes_during_a_run_is_one_line(killer: Killer) -> None:
    out = killer.folder / "vanishing"
    watch = threading.Thread(target=remove_when_begun, args=(out,))
    watch.start()
    status, said = killer.run(COMMANDS["relight"].arguments(killer.folder, out))
    watch.join()
    assert status == 2 and len(said.splitlines()) == 1
    assert said.startswith(f"hyjax: {out}") and "cannot write (No such file or directory)" in said


def remove_when_begun(out: Path) -> None:
    end = time.monotonic() + 300
    while not list(out.glob("*.png")) and time.monotonic() < end:
        time.sleep(0.005)
    gone = out.with_name("gone")
    out.rename(gone)  # at once: while its files are removed one by one, the run may make new ones, and it stays
    shutil.rmtree(gone, ignore_errors=True)


def test_damage_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "b.json").write_text("{")
    (tmp_path / ".c.host-1-1.part.json").write_text("{")
    (tmp_path / "d.json").write_text("{}")
    assert [text.split(":")[0] for text in damages(tmp_path)] == ["damaged", "damaged"]
