"""Tables of the documentation from kept rows: what is written, what is found to differ, what is kept."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import experiments
from experiments import tables
from experiments.blocks import Table
from experiments.command import RunConfig
from experiments.gallery import FIGURES, PICTURES, Cells, cut, stacked
from experiments.packing import packed, unpacked
from experiments.provenance import command, load
from experiments.published import TABLES, Published
from experiments.records import ROOT, Results
from hyjax.util.contact_sheet import contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

REMOVED = {
    "experiment": "earlier",
    "source": "removed",
    "commit": "0123456789" * 4,
    "date": "2026-01-02",
    "origin": "Made on a Tuesday.",
    "caption": "What it shows.",
    "names": 1,
    "header": ["", "dB", "ms"],
}


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A documentation of one page, with an empty table `scores`, and its rows."""
    kept = tmp_path / "evidence"
    kept.mkdir()
    lines = [REMOVED, {"cells": ["ours", "30.1", "3"]}, {"cells": ["theirs", "29.0", "9"]}]
    (kept / "scores.jsonl").write_text("\n".join(map(json.dumps, lines)))
    (tmp_path / "README.md").write_text("Before.\n\n<!-- table: scores -->\n<!-- end -->\n\nAfter.\n")
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr(tables, "KEPT_FOLDER", kept)
    monkeypatch.setattr(tables, "TABLES", {"scores": Published("scores")})
    tables.kept_run.cache_clear()
    return tmp_path / "README.md"


def test_a_table_is_written_between_its_marks_with_where_it_comes_from(page: Path) -> None:
    tables.main(tables.Config())
    text = page.read_text()
    assert "| ours | 30.1 | 3 |\n| theirs | 29.0 | 9 |" in text
    assert "Made on a Tuesday. That commit has the experiment, which was" in text
    assert text.startswith("Before.\n\n<!-- table: scores -->\n") and text.endswith("<!-- end -->\n\nAfter.\n")
    tables.main(tables.Config())
    assert page.read_text() == text


def test_a_table_that_was_edited_by_hand_is_named(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables.main(tables.Config())
    tables.main(tables.Config(check=True))
    edited = page.read_text().replace("30.1", "31.1")
    page.write_text(edited)
    with pytest.raises(SystemExit, match="1"):
        tables.main(tables.Config(check=True))
    assert "README.md: table scores is not what its rows say" in capsys.readouterr().err
    assert page.read_text() == edited


def test_a_table_that_is_on_no_page_is_named(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page.write_text("Nothing.\n")
    with pytest.raises(SystemExit):
        tables.main(tables.Config(check=True))
    assert "scores: is on no page" in capsys.readouterr().err


def test_an_unknown_table_is_bad_input(page: Path) -> None:
    page.write_text("<!-- table: scoers -->\n<!-- end -->\n")
    with pytest.raises(InputError, match="no table 'scoers'"):
        tables.main(tables.Config())


def test_kept_rows_are_those_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = Results(tmp_path, "stage_times", RunConfig())
    results.add(kind="time", values=[1.0, 2.5], note="ü")
    results.add(kind="tried", values=[3.0])
    monkeypatch.setattr(tables, "KEPT_FOLDER", tmp_path / "kept")
    found = tables.kept_rows(tables.keep(results.path, "name", "idle", ("tried",)))
    assert found == [row | {"load_told": "idle"} for row in results.rows[:1]]
    assert load(found) == "idle"


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(0, 2) | st.text("ab", max_size=2) | st.lists(st.none()),
    lambda inner: st.dictionaries(st.sampled_from("abc"), inner),
)


@given(st.lists(st.dictionaries(st.sampled_from("kxy"), VALUES)))
def test_rows_come_back_as_they_were_packed(rows: list[dict[str, Any]]) -> None:
    assert json.dumps(list(unpacked(json.loads(json.dumps(packed(rows)))))) == json.dumps(rows)


def test_evidence_is_small() -> None:
    assert sum(path.stat().st_size for path in tables.KEPT_FOLDER.iterdir()) <= 1_000_000


@given(st.floats(-1e300, 1e300))
def test_numbers_are_kept_to_five_digits(value: float) -> None:
    (found,) = tables.rounded({"a": [value]})["a"]
    assert found == pytest.approx(value, rel=5.1e-5)
    assert found == float(f"{found:.4e}")


def test_columns_and_lines_of_a_table_are_chosen_by_name() -> None:
    made = Table("All.", ["", "dB", "ms"], [["ours", "30.1", "3"], ["theirs", "29.0", "9"]])
    chosen = tables.selected([made], Published("rows", 0, ("ms",), ("theirs",), "Some."))
    assert chosen == Table("Some.", ["", "ms"], [["theirs", "9"]])
    twice = Table("Twice.", ["", "dB", "dB"], [["ours", "30.1", "27.3"]])
    assert tables.selected([twice], Published("rows")) == twice
    with pytest.raises(InputError, match="'dB' twice"):
        tables.selected([twice], Published("rows", 0, ("dB",)))
    for wrong in (Published("rows", 1), Published("rows", 0, ("s",)), Published("rows", 0, (), ("nobody",))):
        with pytest.raises(InputError, match="rows: "):
            tables.selected([made], wrong)


def test_the_command_has_the_options_that_are_not_usual() -> None:
    settings = {"repeats": 20, "sampling": 2, "capture": "$HYJAX_DATA/a b", "lights": "noon-window"}
    row = {"experiment": "stage_times", "settings": settings}
    assert command(row) == 'python -m experiments.stage_times --capture "$HYJAX_DATA/a b" --repeats 20'


def test_the_command_of_an_own_experiment_is_its_file_but_a_missing_package_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert command({"experiment": "my_own", "settings": {}}) == "python my_own.py"
    (tmp_path / "needing.py").write_text("import no_such_package")
    monkeypatch.setattr(experiments, "__path__", [*experiments.__path__, str(tmp_path)])
    with pytest.raises(ModuleNotFoundError, match="no_such_package"):
        command({"experiment": "needing", "settings": {}})


def test_every_kept_file_is_published() -> None:
    assert {path.stem for path in tables.KEPT_FOLDER.glob("*.jsonl")} == {
        published.rows for published in TABLES.values()
    }


def test_every_committed_picture_and_its_command_are_on_the_page_of_results() -> None:
    text = (ROOT / "docs" / "results" / "index.md").read_text(encoding="utf-8")
    assert {path.name for path in FIGURES.iterdir()} == PICTURES.keys()
    for file, picture in PICTURES.items():
        assert f"| `{file}` | `{picture.command}` |" in text


@pytest.mark.slow
def test_all_tables_are_what_their_rows_say() -> None:
    tables.main(tables.Config(check=True))


@pytest.mark.parametrize(("rows", "columns"), [((), ()), ((1,), (1, 0))])
def test_cells_of_a_contact_sheet_are_those_that_were_put_there(
    rows: Sequence[int], columns: Sequence[int]
) -> None:
    shades = [[np.full((24, 32, 3), 0.1 * (3 * r + c + 1), np.float32) for c in range(2)] for r in range(2)]
    sheet = contact_sheet([("", pictures) for pictures in shades], ["", ""])
    found = cut(to_bytes(sheet), Cells("", tuple(rows), tuple(columns), height=240))
    chosen = [[shades[r][c] for c in columns or range(2)] for r in rows or range(2)]
    expected = contact_sheet([("", pictures) for pictures in chosen], [""] * len(chosen[0]))
    assert np.array_equal(found, to_bytes(expected))
    assert stacked([found, found]).shape[0] == 2 * found.shape[0] - 20
