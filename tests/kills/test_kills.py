"""Commands that are killed, and two that write to one folder; `python -m tests.kills` does more of it."""

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
    outcome = killer.kill(COMMANDS[name], 3)
    assert outcome.kills == 3 and outcome.finished >= 2
    assert not outcome.wrong


@pytest.mark.slow
@pytest.mark.parametrize("name", ["relight", "convert"])
def test_two_runs_into_one_folder(name: str, killer: Killer) -> None:
    assert not killer.together(COMMANDS[name])


def test_damage_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "b.json").write_text("{")
    (tmp_path / ".c.host-1-1.part.json").write_text("{")
    (tmp_path / "d.json").write_text("{}")
    assert [text.split(":")[0] for text in damages(tmp_path)] == ["damaged", "damaged"]
