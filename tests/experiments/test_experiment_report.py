"""Blocks of a report as Markdown and HTML, and the page that is made of all runs' rows."""

import dataclasses
import re
import sys
import types
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from experiments import report
from experiments.blocks import Block, Picture, Plot, Table, html, markdown, write_blocks
from experiments.plotting import new_figure
from experiments.records import FILE, Results, Row
from hyjax.util.errors import InputError
from hyjax.util.images import write_png

TABLE = Table("What it shows.", ["", "loss", "a|b"], [["<b>bold</b>", "0.5", "1 & 2"], ["x|y", "–", ""]])


DOCSTRING = """What is <asked>.

    python -m experiments.fake [--size 3]

Expect:
- one
  thing;
- another.
"""


class Parsed(HTMLParser):
    """Every element with its attributes, every text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def names(self) -> list[str]:
        return [name for name, _ in self.elements]


@dataclasses.dataclass(frozen=True)
class Config:
    note: str = "a <i>note</i>"
    seed: int = 3


def plot(name: str = "curve") -> Plot:
    figure = new_figure(3, 2)
    figure.subplots().plot([1, 2, 3], [1, 4, 9], marker="o", label="squares")
    return Plot(name, f"The {name}.", figure)


def fake_blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    scores = [row for row in rows if row.get("kind") == "score"]
    table = Table("Losses.", ["", "loss"], [[row["name"], f"{row['loss']:.2f}"] for row in scores])
    return [f"Of {len(scores)} scores.", table, plot(), Picture(folder / "seen.png", "What was seen.")]


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty results folder, and experiments `fake_a` and `fake_b`."""
    for name in ("fake_a", "fake_b"):
        module = types.ModuleType(f"experiments.{name}")
        main = types.SimpleNamespace(name=name, title=f"Title of {name}", blocks=fake_blocks)
        vars(module).update(main=main, __doc__=DOCSTRING)
        monkeypatch.setitem(sys.modules, f"experiments.{name}", module)
    monkeypatch.setattr(report, "EXPERIMENTS", ("fake_b", "fake_a"))
    (tmp_path / "results").mkdir()
    return tmp_path / "results"


def write_run(folder: Path, experiment: str = "fake_a", *, finish: bool = True, picture: bool = True) -> None:
    rows = Results(folder, experiment, Config())
    rows.add(kind="score", name="<script>alert(1)</script>", loss=0.25)
    if finish:
        rows.finish()
    if picture:
        write_png(folder / "seen.png", np.full((4, 6, 3), 0.5))


def make_page(results: Path) -> str:
    out = results.parent / "page" / "report.html"
    report.main(report.Config(results, out))
    return out.read_text()


# ---- blocks ----


def test_markdown_tables() -> None:
    lines = markdown(["Some text.", TABLE]).splitlines()
    assert lines[:2] == ["Some text.", ""] and lines[2] == "What it shows."
    assert lines[4:] == [
        r"|  | loss | a\|b |",
        "|---|---:|---:|",
        "| <b>bold</b> | 0.5 | 1 & 2 |",
        r"| x\|y | – |  |",
    ]


def test_figures_and_pictures_in_markdown_are_named() -> None:
    text = markdown([plot("one"), Picture(Path("some/where/two.png"), "The two.")])
    assert text == "one.png: The one.\n\ntwo.png: The two."


def test_html_is_escaped() -> None:
    text = "".join(html(["1 < 2 & <b>", TABLE, Picture(Path("missing.png"), '"<i>quoted</i>"')]))
    parsed = Parsed(text)
    assert not {"b", "i", "script"} & set(parsed.names())
    assert {"1 < 2 & <b>", "<b>bold</b>", "1 & 2", "x|y", '"<i>quoted</i>"'} <= set(parsed.texts)
    assert parsed.names().count("td") == 6 and parsed.names().count("th") == 3


def test_a_missing_or_broken_picture_is_said_in_the_page(tmp_path: Path) -> None:
    (tmp_path / "broken.png").write_bytes(b"no picture")
    for name in ("missing.png", "broken.png"):
        (text,) = html([Picture(tmp_path / name, "Nothing to see.")])
        parsed = Parsed(text)
        assert "img" not in parsed.names() and "figcaption" in parsed.names()
        assert any("The picture is missing" in said and name in said for said in parsed.texts)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_picture_is_packed_in(tmp_path: Path, channels: int) -> None:
    write_png(tmp_path / "picture.png", np.full((4, 6, channels), 0.5))
    (text,) = html([Picture(tmp_path / "picture.png", "Half grey.")])
    ((_, attributes),) = [element for element in Parsed(text).elements if element[0] == "img"]
    assert (attributes["src"] or "").startswith("data:image/") and attributes["alt"] == "Half grey."


def test_the_same_figure_is_the_same_markup() -> None:
    assert html([plot()]) == html([plot()])


def test_figures_of_one_page_share_no_name_for_different_things() -> None:
    one, other = plot(), plot("other")
    other.figure.axes[0].set_position((0.2, 0.2, 0.5, 0.5))
    definitions: dict[str, str] = {}
    for text in html([one, other]):
        for key, body in re.findall(r'<clipPath id="(\w+)">(.*?)</clipPath>', text, re.DOTALL):
            assert definitions.setdefault(key, body) == body
    assert len(definitions) == 2


def test_blocks_are_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_blocks(tmp_path, "results", ["Text.", TABLE, plot()])
    assert (
        (tmp_path / "results.md").read_text()
        == capsys.readouterr().out
        == markdown(["Text.", TABLE, plot()]) + "\n"
    )
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curve.png", "results.md"]


# ---- page ----


def test_a_page_of_one_run(results: Path) -> None:
    write_run(results / "fake_a")
    parsed = Parsed(make_page(results))
    texts = " ".join(parsed.texts)
    assert parsed.names().count("section") == parsed.names().count("h2") == 1
    assert "script" not in parsed.names() and "<script>alert(1)</script>" in parsed.texts
    assert {"Title of fake_a", "Of 1 scores.", "0.25", "The curve.", "What was seen."} <= set(parsed.texts)
    assert "did not come to its end" not in texts
    assert "1 rows; commit " in texts and 'note "a <i>note</i>", seed 3' in texts and "cores, jax" in texts


def test_a_run_begins_with_what_its_module_says(results: Path) -> None:
    write_run(results / "fake_a")
    text = make_page(results)
    assert '<p class="lead">What is &lt;asked&gt;.</p>' in text
    assert (
        "<pre>python -m experiments.fake [--size 3]</pre><p>Expect:</p><p>- one\nthing;</p><p>- another.</p>"
        in text
    )


def test_two_runs_are_two_sections_in_the_order_of_the_experiments(results: Path) -> None:
    write_run(results / "fake_a" / "room")
    write_run(results / "fake_a" / "kitchen")
    write_run(results / "z" / "fake_b", "fake_b")
    parsed = Parsed(make_page(results))
    titles = [f"Title of fake_{name}" for name in ("b", "a: kitchen", "a: room")]
    sections = [attributes["id"] for name, attributes in parsed.elements if name == "section"]
    links = [attributes["href"] for name, attributes in parsed.elements if name == "a"]
    assert [text for text in parsed.texts if text.startswith("Title of")] == 2 * titles  # contents, headings
    assert links == [f"#{key}" for key in sections] and len(set(sections)) == 3


def test_an_interrupted_run_says_so(results: Path) -> None:
    write_run(results / "fake_a", finish=False, picture=False)
    texts = Parsed(make_page(results)).texts
    assert "This run did not come to its end." in texts and "Of 1 scores." in texts
    assert any("The picture is missing" in text for text in texts)


def test_the_page_needs_nothing_else(results: Path) -> None:
    write_run(results / "fake_a")
    text = make_page(results)
    parsed = Parsed(text)
    assert {"svg", "img", "table"} <= set(parsed.names())
    assert not {"script", "link", "iframe", "object", "base"} & set(parsed.names())
    for _, attributes in parsed.elements:
        for key in ("src", "href", "xlink:href", "srcset", "data", "action"):
            assert (attributes.get(key) or "#").startswith(("#", "data:image/"))
    assert "@import" not in text and all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))
    namespaces = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}  # names, never fetched
    assert set(re.findall(r"https?://[^\"'\s<>]+", text)) <= namespaces


def test_the_same_rows_make_the_same_page(results: Path) -> None:
    write_run(results / "fake_a")
    assert make_page(results) == make_page(results)


def test_rows_of_several_commits_name_them_all(results: Path) -> None:
    write_run(results / "fake_a")
    path = results / "fake_a" / FILE
    path.write_text(re.sub(r'"commit": "[^"]*"', f'"commit": "{"0" * 40}-dirty"', path.read_text(), count=1))
    assert any(f"commit {'0' * 12}-dirty, " in text for text in Parsed(make_page(results)).texts)


def test_nothing_to_show(results: Path) -> None:
    with pytest.raises(InputError, match="no such folder; run an experiment first"):
        report.main(report.Config(results / "elsewhere"))
    with pytest.raises(InputError, match="run an experiment first"):
        report.main(report.Config(results))
    (results / FILE).write_text("")
    with pytest.raises(InputError, match="run an experiment first"):
        report.main(report.Config(results))


def test_an_unknown_experiment_is_left_out(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(results / "fake_a")
    page = make_page(results)
    write_run(results / "some", "no_such_experiment")
    assert make_page(results) == page
    assert "some: left out, as 'no_such_experiment' is not in EXPERIMENTS" in capsys.readouterr().err


def test_a_page_that_cannot_be_written(results: Path) -> None:
    write_run(results / "fake_a")
    (results / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write there"):
        report.main(report.Config(results, results / "file" / "report.html"))


def test_one_broken_run_does_not_take_the_page_with_it(results: Path) -> None:
    write_run(results / "good")
    rows = Results(results / "bad", "fake_b", Config())
    rows.add(kind="score", name="no loss, as an older version of the code might have left it")
    rows.finish()
    parsed = Parsed(make_page(results))
    assert any("These rows cannot be shown (KeyError" in text for text in parsed.texts)
    assert "0.25" in parsed.texts


def test_docstrings_keep_their_marks() -> None:
    assert report.marked("a `b < c` *d e* 2 * 3") == "a <code>b &lt; c</code> <em>d e</em> 2 * 3"
