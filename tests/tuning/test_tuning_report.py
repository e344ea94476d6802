"""What a tuning run leaves: whole files, readable tables, a page that stands alone and escapes everything."""

import base64
import csv
import dataclasses
import importlib.resources
import itertools
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup
from page_checks import RUDE, parse

from hyjax.core.schedule import Level, Schedule
from hyjax.tuning import report
from hyjax.tuning.report_axes import COLORS
from hyjax.tuning.report_html import templates
from hyjax.tuning.report_pictures import data_uris, pair_to_compare
from hyjax.tuning.report_points import MARKERS
from hyjax.tuning.report_text import candidates, kind_of_baseline
from hyjax.tuning.result import Budget, Candidate, Milliseconds, Scores, Tuned
from hyjax.util.contact_sheet import contact_sheet, write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

FPS60, MS8, RUDEST = Budget("60 fps", 1000 / 60), Budget("8 ms", 8.0), Budget(f"../{RUDE}", 30.0)
GUIDED = ("tuned", "hyjax", "trial")


def scores(loss: float) -> Scores:
    return Scores(loss, {"psnr": 20 - 10 * math.log10(loss), "ssim": 1 - loss})


def candidate(name: str, steps: list[tuple[int, int]], ms: float, loss: float, **changes: Any) -> Candidate:
    form: dict[str, Any] = {"pooling": "guide", "upsampling": "guide"} if name.startswith(GUIDED) else {}
    levels = []
    for i, (factor, n) in enumerate(steps):
        sizes, fidelity = np.linspace(0.1 + 0.01 * i, 0.24, n, dtype=np.float32), np.float32(0.1 * (i + 1))
        levels.append(Level(factor, sizes, np.float32(0.02 * (i + 1)), fidelity if form else None))
    values = {
        "predicted": Milliseconds(0.96 * ms, 1.05 * ms),
        "measured": Milliseconds(ms, 1.1 * ms),
        "tuning": scores(loss),
        "held_out": scores(1.1 * loss),
    }
    return Candidate(Schedule(tuple(levels), name=name, **form), **(values | changes))


def fake(budgets: list[Budget], *, baselines: bool = True, front: int = 5, **changes: Any) -> Tuned:
    """A run with a best candidate for each budget, more on the front, and the usual baselines."""
    best = []
    for budget in budgets:
        steps, ms = [(16, 4), (4, 8), (2, round(budget.milliseconds))], 0.97 * budget.milliseconds
        best.append(candidate(f"tuned-{budget.slug}", steps, ms, 0.5 / budget.milliseconds))
    times = [2.0 + 3 * i for i in range(front)]
    rest = [candidate(f"tuned-{t:.0f}", [(8, 3), (2, round(t))], t, 0.55 / t, **changes) for t in times]
    usual = [
        candidate("hyjax", [(16, 3), (8, 4), (4, 6)], 3.3, 0.2, **changes),
        candidate("paper-50", [(16, 5), (8, 10), (4, 15), (2, 20)], 7.7, 0.09, **changes),
        candidate("paper-80", [(16, 10), (8, 15), (4, 25), (2, 30)], 11.3, 0.07, **changes),
        candidate("naive-50", [(2, 50)], 14.0, 0.4, **changes),
        candidate("naive-1000", [(2, 1000)], 260.0, 0.12, **changes),
    ]
    history = [
        {
            "seconds": 3.0 * i,
            "budget": b.label,
            "phase": "structure" if i < 6 else "gradients",
            "loss": (0.5 + 1 / b.milliseconds) / (1 + i),
        }
        for b in budgets
        for i in range(12)
    ]
    record = {
        "device": "cpu: cpu",
        "versions": {"jax": "0.10.2"},
        "latency": {"median_error_percent": 3.2, "steps": RUDE},
        "settings": {"seed": 0, RUDE: RUDE},
    }
    return Tuned(
        best[0].schedule, best, budgets, sorted([*best, *rest], key=lambda c: c.predicted.median),
        usual if baselines else [], history, record,
    )  # fmt: skip


def bare() -> Tuned:
    """The least there can be: nothing known but predictions, no baseline, no step of search, an empty record."""
    lone = candidate("tuned-60fps", [(2, 0)], 5.0, 1.0, measured=None, tuning=None, held_out=None)
    return Tuned(lone.schedule, [lone], [FPS60], [lone], [], [], {})


RUNS: dict[str, Callable[[], Tuned]] = {
    "one budget": lambda: fake([FPS60]),
    "three budgets, rude names": lambda: fake([FPS60, MS8, RUDEST]),
    "no baselines": lambda: fake([FPS60], baselines=False),
    "not measured, not held out": lambda: fake([FPS60], measured=None, held_out=None),
    "no truth": lambda: fake([MS8], tuning=Scores(0.1, {"psnr": math.nan, "ssim": math.inf}), held_out=None),
    "bare": bare,
}


@pytest.fixture(params=RUNS)
def tuned(request: pytest.FixtureRequest) -> Tuned:
    return RUNS[request.param]()


def examples(count: int = 2, height: int = 24, width: int = 32, seed: int = 0) -> list[report.Example]:
    rng = np.random.default_rng(seed)
    headings = ["frame", "paper-50 filter", "tuned filter", "paper-50", "tuned", f"target {RUDE}"]
    return [
        report.Example(
            f"frame {i} {RUDE}",
            {heading: rng.uniform(-0.1, 1.1, (height, width, 3)).astype(np.float32) for heading in headings},
            f"paper-50 3.11 ms {RUDE}",
        )
        for i in range(count)
    ]


# ---- schedules ----


def test_one_budget_one_schedule(tmp_path: Path) -> None:
    tuned = fake([FPS60])
    assert report.write_schedules(tmp_path, tuned) == [tmp_path / "schedule.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["schedule.json"]
    again = Schedule.from_json((tmp_path / "schedule.json").read_text())
    assert again.to_json() == tuned.schedule.to_json()


def test_several_budgets_have_a_file_each_in_the_folder(tmp_path: Path) -> None:
    tuned = fake([FPS60, MS8, RUDEST, Budget("8ms", 8.0)])
    files = report.write_schedules(tmp_path, tuned)
    names = ["schedule.json", "schedule-60fps.json", "schedule-8ms.json", "schedule-b-amp-x-script.json"]
    assert files == [tmp_path / name for name in [*names, "schedule-8ms-2.json"]]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    for path, best in zip(files[1:], tuned.best, strict=True):
        assert Schedule.from_json(path.read_text()).to_json() == best.schedule.to_json()


# ---- table ----


def test_csv_reads_back(tmp_path: Path) -> None:
    tuned = fake([FPS60, RUDEST])
    report.write_pareto_csv(tmp_path / "pareto.csv", tuned)
    with (tmp_path / "pareto.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = [row["name"] for row in rows]
    assert sorted(names) == sorted({c.name for c in [*tuned.front, *tuned.best, *tuned.baselines]})
    assert list(rows[0]) == [*report.CSV_COLUMNS, *report.score_columns()]
    best = rows[names.index("tuned-60fps")]
    assert best["kind"] == "tuned" and best["best_for"] == "60 fps" and best["schedule"] == "16:4 4:8 2:17"
    assert rows[names.index(f"tuned-{RUDEST.slug}")]["best_for"] == RUDEST.label
    assert float(best["measured_median_ms"]) == pytest.approx(tuned.best[0].measured.median, rel=1e-5)  # type: ignore[union-attr]
    assert float(best["held_out_loss"]) == pytest.approx(0.033)
    for level, kappa, lam in zip(tuned.schedule.levels, best["kappa"].split(), best["lam"].split(), strict=True):
        assert float(kappa) == pytest.approx(float(level.kappa), rel=1e-5)
        np.testing.assert_allclose([float(x) for x in lam.split("/")], level.step_sizes, rtol=1e-5)
    held = [float(x) for x in best["fidelity"].split()]
    np.testing.assert_allclose(held, [level.fidelity for level in tuned.schedule.levels], rtol=1e-5)
    assert (best["pooling"], best["upsampling"], best["norm"]) == ("guide", "guide", "l2")
    paper = rows[names.index("paper-50")]
    assert (paper["pooling"], paper["upsampling"], paper["fidelity"]) == ("edges", "bilinear", "- - - -")
    assert {row["kind"] for row in rows if row["name"].startswith(("hyjax", "paper", "naive"))} == {"baseline"}


def test_csv_leaves_empty_what_is_unknown(tmp_path: Path) -> None:
    report.write_pareto_csv(tmp_path / "pareto.csv", bare())
    with (tmp_path / "pareto.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    unknown = {key for key, value in row.items() if value == ""}
    assert unknown == {key for key in row if key.startswith(("measured", "tuning", "held_out"))}
    assert row["schedule"] == "2:0" and row["lam"] == "-"


def test_every_candidate_once() -> None:
    """A best candidate under its budget's name and on the front under another is one row, told as the best."""
    tuned = fake([FPS60], front=1)
    twin = candidate("trial-7", [(16, 4), (4, 8), (2, 17)], 16.0, 0.1)
    tuned = Tuned(tuned.schedule, tuned.best, tuned.budgets, [twin, *tuned.front], tuned.baselines, [], {})
    names = [c.name for _, c in candidates(tuned)]
    assert names == ["tuned-2", "tuned-60fps", "hyjax", "paper-50", "paper-80", "naive-50", "naive-1000"]


@pytest.mark.parametrize("change", [{"upsampling": "bilinear"}, {"pooling": "edges"}, {"norm": "mean_abs"}])
def test_what_differs_in_form_alone_is_another(change: dict[str, Any]) -> None:
    tuned = fake([FPS60], front=1)
    other = dataclasses.replace(tuned.best[0].schedule, name="trial-7", **change)
    other = dataclasses.replace(tuned.best[0], schedule=other)
    tuned = Tuned(tuned.schedule, tuned.best, tuned.budgets, [other], [], [], {})
    assert [c.name for _, c in candidates(tuned)] == ["tuned-60fps", "trial-7"]


def test_whose_a_baseline_is() -> None:
    kinds = {c.name: kind_of_baseline(c) for c in fake([FPS60]).baselines}
    want = {"hyjax": "preset", "paper-50": "paper", "paper-80": "paper", "naive-50": "naive", "naive-1000": "naive"}
    assert kinds == want and set(COLORS) >= {"tuned", *want.values()} and set(MARKERS) >= {"tuned", *want.values()}
    style = importlib.resources.files("hyjax.tuning").joinpath("report.css").read_text(encoding="utf-8")
    assert all(style.count(f"--{kind}: #") == 2 for kind in want.values()), "in light and in dark"


# ---- sentences ----


def test_the_first_sentence_says_it_all() -> None:
    (said,) = report.summary(fake([FPS60]))
    assert said == (
        "60 fps = 16.67 ms: schedule 16:4 4:8 2:17, measured median 16.17 ms, p95 17.78 ms; "
        "loss 0.033 against 0.077 of paper-80 at 11.30 ms (held-out frames)."
    )


def test_sentences_where_less_is_known() -> None:
    assert report.summary(bare()) == ["60 fps = 16.67 ms: schedule 2:0."]
    assert report.summary(fake([MS8], baselines=False))[0].endswith("p95 8.54 ms; loss 0.06875.")
    assert "8 ms: schedule" in report.summary(fake([MS8]))[0]
    tight = report.summary(fake([Budget("1 ms", 1.0)]))[0]
    assert tight.endswith("of hyjax at 3.30 ms, which does not fit (held-out frames).")
    mixed = report.summary(fake([FPS60], held_out=None))[0]
    assert mixed.endswith("loss 0.03 against 0.07 of paper-80 at 11.30 ms (tuning frames).")


# ---- plot ----


def test_the_plot_shows_every_point_and_budget(tuned: Tuned) -> None:
    figure = report.draw_pareto(tuned)
    upper, lower = figure.axes
    for axes, known in (
        (upper, [c for _, c in candidates(tuned) if c.tuning]),
        (lower, [c for _, c in candidates(tuned) if (c.held_out or c.tuning)]),
    ):
        marks = [line for line in axes.lines if line.get_marker() not in ("None", "", None)]
        assert len(marks) <= len(known)
        dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
        assert [line.get_xdata()[0] for line in dashed] == [budget.milliseconds for budget in tuned.budgets]
    words = [text.get_text() for text in upper.texts]
    assert {budget.label for budget in tuned.budgets} <= set(words)
    if any(c.tuning for c in tuned.baselines):
        assert {c.name for c in [*tuned.baselines, *tuned.best]} <= set(words)
    assert upper.get_xscale() == "log"


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_plot_is_written(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"pareto.{suffix}"
    report.write_pareto_plot(path, fake([FPS60, MS8, RUDEST]))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    if suffix == "png":
        assert read_image(path).shape[1] == 1800


# ---- page ----


@pytest.mark.slow
def test_the_page_stands_alone(tuned: Tuned, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    report.write_report(path, tuned, examples())
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"https?:|@import|url\((?!#)", text)
    page = parse(text)
    words = "".join(page.text)
    assert report.summary(tuned)[0] in words
    for _, known in candidates(tuned):
        assert known.name in words
    assert words.count(RUDE) >= 2 * 3
    assert page.drawings == {"pareto", "history"} | ({"latency"} if "latency" in page.ids else set())
    assert not re.search(r"<(?!b>|/script>)", words)
    for example in examples():
        assert example.name in words and example.note in words


def test_the_page_tells_each_levels_values(tmp_path: Path) -> None:
    tuned = fake([FPS60])
    report.write_report(tmp_path / "r.html", tuned, [])
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count("pooling guide, upsampling guide, norm l2") == 1 + 5 + 1
    assert text.count("pooling edges, upsampling bilinear, norm l2") == 4
    for values in (("4", "8", "0.04", "0.2"), ("4", "15", "0.06", "–")):  # the tuned one's, and paper-50's
        assert "<tr>" + "".join(f'<td class="n">{value}</td>' for value in values) + "<td>" in text


def test_no_examples_no_pictures(tmp_path: Path) -> None:
    report.write_report(tmp_path / "r.html", fake([FPS60]), [])
    page = parse((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert not {"img", "script", "dialog"} & page.used and "pictures" not in page.ids


def test_the_record_is_told_in_full(tmp_path: Path) -> None:
    tuned = fake([FPS60])
    report.write_report(tmp_path / "r.html", tuned, [])
    words = "".join(parse((tmp_path / "r.html").read_text(encoding="utf-8")).text)
    assert json.dumps(tuned.record, indent=2) in words
    assert "median error percent" in words and "3.2" in words


def test_templates_escape_all_but_markup(tmp_path: Path) -> None:
    (tmp_path / "t.jinja").write_text('<a title="{{ text }}">{{ text }}{{ mark }}</a>')
    escaped = "&lt;b&gt;&amp;amp;&#34;&#39;$x_$&lt;/script&gt;"
    shown = templates(tmp_path).get_template("t.jinja").render(text=RUDE, mark=Markup("<i></i>"))
    assert shown == f'<a title="{escaped}">{escaped}<i></i></a>'


# ---- pictures ----


def test_pictures_are_lossless_where_they_fit(tmp_path: Path) -> None:
    (example,) = examples(1)
    (uris,) = data_uris([example])
    assert list(uris) == list(example.pictures)
    for heading, uri in uris.items():
        np.testing.assert_allclose(decode(uri, tmp_path), np.clip(example.pictures[heading], 0, 1), atol=0.51 / 255)


def test_pictures_shrink_until_they_fit(tmp_path: Path) -> None:
    given = examples(2, 300, 400)
    found = data_uris(given, most_bytes=400_000)
    sizes = {decode(uri, tmp_path).shape for uris in found for uri in uris.values()}
    assert len(sizes) == 1 and (300, 400, 3) not in sizes
    assert all(uri.startswith("data:image/jpeg") for uris in found for uri in uris.values())
    assert sum(len(uri) for uris in found for uri in uris.values()) < 4 / 3 * 400_000 + 12 * 40
    with pytest.raises(InputError, match="2 examples are too many"):
        data_uris(given, most_bytes=1000)


def decode(uri: str, folder: Path) -> np.ndarray:
    head, content = uri.split(",")
    path = folder / f"x.{'png' if 'png' in head else 'jpg'}"
    path.write_bytes(base64.b64decode(content))
    return read_image(path)


@pytest.mark.parametrize(
    ("headings", "pair"),
    [
        (["frame", "paper-50 filter", "tuned filter", "paper-50", "tuned", "target"], (3, 4)),
        (["a", "b", "c"], (1, 2)),
        (["a"], (0, 0)),
    ],
)
def test_pair_to_compare(headings: list[str], pair: tuple[int, int]) -> None:
    assert pair_to_compare(headings) == pair


def test_contact_sheet(tmp_path: Path) -> None:
    one, two = examples(2)
    two = report.Example(two.name, dict(itertools.islice(two.pictures.items(), 2)))
    rows, headings = report.contact_sheet_rows([one, two])
    assert headings == list(one.pictures) and [len(pictures) for _, pictures in rows] == [6, 6]
    assert [label for label, _ in rows] == [f"{one.name}: {one.note}", two.name]
    write_contact_sheet(tmp_path / "contact_sheet.png", rows, headings)
    np.testing.assert_allclose(
        read_image(tmp_path / "contact_sheet.png"), contact_sheet(rows, headings), atol=0.6 / 255
    )


# ---- failures ----


def test_nothing_is_left_where_writing_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tuned = fake([FPS60])
    gone = tmp_path / "gone"
    for write in (
        lambda: report.write_schedules(gone, tuned),
        lambda: report.write_pareto_csv(gone / "pareto.csv", tuned),
        lambda: report.write_pareto_plot(gone / "pareto.png", tuned),
        lambda: report.write_report(gone / "report.html", tuned, []),
    ):
        with pytest.raises(InputError, match="cannot write") as caught:
            write()
        assert "\n" not in str(caught.value)
    assert not gone.exists()

    old = tmp_path / "report.html"
    old.write_text("old")
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    for write in (
        lambda: report.write_report(old, tuned, examples()),
        lambda: report.write_pareto_plot(tmp_path / "pareto.png", tuned),
    ):
        with pytest.raises(InputError, match="disk full"):
            write()
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"] and old.read_text() == "old"
