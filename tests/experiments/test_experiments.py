"""Every experiment describes itself and makes blocks even of no rows; one of them from command to page."""

import importlib
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from reference.arkit_export import write_depth
from reference.seven_scenes_export import export_seven_scenes

from experiments import EXPERIMENTS, report, structure
from experiments.blocks import html, markdown
from experiments.command import Experiment, run
from experiments.records import FILE, is_finished, of_kind, read_rows
from hyjax.core.schedule import PAPER_KAPPA
from hyjax.data.builtin_room import load_room


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Three frames of the built-in room in the 7-Scenes layout."""
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    frames = [room[i] for i in (0, 1, 2)]
    folder = export_seven_scenes(frames, room.up, tmp_path / "some_room")
    for number, frame in enumerate(frames):
        assert frame.depth is not None
        write_depth(folder / f"frame-{number:06d}.depth.png", 1000 * frame.depth)
    return folder


def call(monkeypatch: pytest.MonkeyPatch, main: Callable[..., Any], *options: str) -> None:
    """As `python -m` does."""
    monkeypatch.setattr(sys, "argv", ["experiment", *options])
    run(main)


def test_every_experiment_is_in_the_report() -> None:
    files = Path(report.__file__).parent.glob("*.py")
    assert {path.stem for path in files if "\n@experiment(" in path.read_text()} == set(EXPERIMENTS)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_describes_itself_and_makes_blocks(name: str, tmp_path: Path) -> None:
    module = importlib.import_module(f"experiments.{name}")
    assert isinstance(module.main, Experiment) and module.main.name == name and module.main.title
    text = inspect.cleandoc(module.__doc__ or "")
    assert f"\n    python -m experiments.{name}" in text and "Takes " in text and "\nExpect: " in text
    none = module.main.blocks([], tmp_path)  # of a run that was interrupted at once
    assert markdown(none) and html(none)


def test_from_the_command_to_the_page(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "results" / "structure"
    call(monkeypatch, structure.main, "--capture", str(capture), "--size", "64", "--out", str(out))
    rows = read_rows(out / FILE)
    found = of_kind(rows, "spread")
    assert is_finished(rows) and len(rows) == len(found) + 1 and found[0]["schedule"] == "noise"
    settings = {"capture": str(capture), "frame": 0, "size": 64, "kappa": PAPER_KAPPA, "seed": 0}
    assert all(row["settings"] == settings and row["seed"] == 0 for row in rows)
    share = f"{100 * found[-1]['variance'] / found[0]['variance']:.3g} %"
    assert f"| paper-80 | {share} | " in (out / "structure.md").read_text()

    page = tmp_path / "report.html"
    call(monkeypatch, report.main, "--results", str(tmp_path / "results"), "--out", str(page))
    text = page.read_text()
    assert f'<td class="n">{share}</td>' in text and text.count("<img ") == 1
    assert str(tmp_path / "results") not in text


def test_bad_input_ends_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as caught:
        call(monkeypatch, structure.main, "--capture", str(tmp_path / "nowhere"), "--out", str(out))
    said = capsys.readouterr().err
    assert caught.value.code == 2 and said.startswith("structure: ") and said.count("\n") == 1 and "nowhere" in said
    assert not (out / FILE).exists()
