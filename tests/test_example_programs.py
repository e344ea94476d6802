"""Examples: short, numbered, in the gallery with a small picture, and running."""

import ast
from pathlib import Path

import pytest
from clocks import steady_clock
from common import without_gradients
from PIL import Image

from examples.__main__ import DOCS, FOLDER, GALLERY, MOST_BYTES, examples, run_example
from examples.gallery import gallery_page

EXAMPLES = examples()
SMALLER = {
    "07_gradient_of_a_schedule": {"STEPS, RATE = 30": "STEPS, RATE = 3"},
    "08_light_design": {"STEPS, REFERENCE_LUX = 150": "STEPS, REFERENCE_LUX = 5"},
    "09_tune_a_schedule": {"trials=12": "trials=4", 'frames="2,8"': 'frames="2"'},
}
"""Settings that stand in an example and those that are executed for them here."""
each_example = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)


def test_they_are_numbered() -> None:
    assert len(EXAMPLES) >= 12
    assert [path.name[:2] for path in EXAMPLES] == [f"{number:02}" for number in range(1, len(EXAMPLES) + 1)]


@each_example
def test_examples_are_short_and_public(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert 20 <= text.count("\n") <= 90
    imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    private = [alias.name for node in imports for alias in node.names if alias.name.startswith("_")]
    assert not private


@each_example
def test_the_gallery_has_their_pictures(path: Path) -> None:
    picture = GALLERY / f"{path.stem}.jpg"
    assert 1000 < picture.stat().st_size <= MOST_BYTES
    Image.open(picture).verify()


def test_the_gallery_is_of_these_examples() -> None:
    assert (DOCS / "gallery.md").read_text(encoding="utf-8") == gallery_page(EXAMPLES), "python -m examples --keep"
    assert {path.stem for path in GALLERY.glob("[0-9]*.jpg")} == {path.stem for path in FOLDER.glob("[0-9]*.py")}


@pytest.mark.slow
@each_example
def test_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    steady_clock(monkeypatch)  # clock and gradients of tuning have tests of their own
    monkeypatch.setattr("hyjax.tuning.this_machine.cache_folder", lambda: tmp_path)  # which keeps its times
    without_gradients(monkeypatch)
    source = path.read_text(encoding="utf-8")
    for old, new in SMALLER.get(path.stem, {}).items():
        assert old in source, f"{old} is no longer in it"
        source = source.replace(old, new)
    program = tmp_path / path.name
    program.write_text(source, encoding="utf-8")
    picture = run_example(program, ["160x120"])
    assert picture.stat().st_size > 1000
