"""Progress bars: of a step by itself, and one for all steps of a command."""

import functools

import pytest

from hyjax.util import progress
from hyjax.util.progress import StepBar, command_bar
from hyjax.util.terminal import FILE_SECONDS, write_above_bars


def shown(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err


def test_a_step_by_itself_has_a_line_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(StepBar(range(3), "fusing", unit="frame")) == [0, 1, 2]
    text = shown(capsys)
    assert "fusing" in text and "3/3" in text


def test_a_disabled_one_shows_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with command_bar("relighting", "frame", disable=True) as bar:
        assert bar is None
        assert list(StepBar(range(3), "fusing", unit="frame", disable=True)) == [0, 1, 2]
    assert not shown(capsys)


def test_steps_of_a_command_share_its_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with command_bar("relighting", "frame", disable=False) as bar:
        assert bar is not None
        with StepBar[None](desc="light", total=2, unit="block") as light:
            light.update()
            for _ in StepBar(range(3), "fusing", unit="frame"):
                pass
        assert list(bar.count(iter("abcd"), 4)) == list("abcd")
    text = shown(capsys)
    assert "light 1/2, fusing 2/3 [" in text
    assert "relighting: 100%" in text and "4/4" in text
    assert text.count("\n") == 1, "one line is left"


def test_a_failing_command_leaves_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="unreadable"), command_bar("relighting", "frame", disable=False):
        StepBar[None](desc="light", total=2, unit="block").update()
        raise ValueError("unreadable")
    text = shown(capsys)
    assert "\n" not in text and text.endswith("\r"), "it is wiped"
    with command_bar("relighting", "frame", disable=False) as bar:
        assert bar is not None, "the one before has ended"


def test_in_a_file_a_command_that_is_refused_at_once_leaves_its_line_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "tqdm", functools.partial(progress.tqdm, mininterval=FILE_SECONDS))
    with command_bar("relighting", "frame", disable=False):
        write_above_bars("hyjax: no such file")
    assert shown(capsys) == "hyjax: no such file\n"
