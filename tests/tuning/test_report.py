"""What a run on the whole frame leaves: whole files, sentences, a table, a page that stands alone."""

import csv
import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_checks import RUDE, parse

from hyjax.configuration import Configuration, GuideOptions, LightOptions
from hyjax.core.schedule import Schedule
from hyjax.tuning import report
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.proof import best_within
from hyjax.tuning.report_plots import draw_effects, draw_front_plot, trial_dots
from hyjax.tuning.report_text import candidates, configuration_text, described
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate, Effect, Tuned
from hyjax.tuning.space import Space
from hyjax.tuning.trial import Trial
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

FPS60, FPS100, RUDEST = Budget("60 fps", 1000 / 60), Budget("100 fps", 10.0), Budget(f"../{RUDE}", 30.0)
SPACE = Space.of(truth=True)
BASE_MS = 20.0


def scores(relative: float) -> dict[str, float]:
    return {"loss": 0.08 * relative, "psnr": 24.0 - relative, "ssim": 0.8, "psnr_raw": 22.0, "relative": relative}


def candidate(name: str, ms: float, relative: float, *, held_out: bool = True, **choices: Any) -> Candidate:
    return Candidate(
        dataclasses.replace(Configuration(), name=name, **choices),
        scores(relative),
        scores(1.02 * relative) if held_out else None,
        FrameTime(ms, 1.1 * ms, BASE_MS, ms / BASE_MS),
    )


def trials() -> list[Trial]:
    rng = np.random.default_rng(0)
    rest = [
        Trial(SPACE.random(rng), "combining", [0.9 + 0.02 * n, 1.0], 0.4 + 0.03 * n if n else None)
        for n in range(5)
    ]
    return [Trial(SPACE.default, "default", [1.0, 1.0], 1.0), *rest]


def fake(budgets: list[Budget], *, held_out: bool = True, ms: float = 9.0, **changes: Any) -> Tuned:
    found = [
        candidate("tuned-0.30", 6.0, 1.1, held_out=held_out, scale=2),
        candidate("tuned-0.45", ms, 0.9, held_out=held_out, guide=GuideOptions(name="none")),
        candidate(f"tuned-{RUDE}", 18.0, 0.8, held_out=held_out, light=LightOptions(sampling=1)),
    ]
    best = [
        dataclasses.replace(
            found[1], configuration=dataclasses.replace(found[1].configuration, name=f"tuned-{b.slug}")
        )
        for b in budgets
    ]
    references = [
        candidate("default", BASE_MS, 1.0, held_out=held_out),
        candidate("fast", 12.0, 1.05, held_out=held_out),
    ]
    paper = candidate("paper", 60.0, 2.4, held_out=held_out)
    references.append(dataclasses.replace(paper, configuration=Configuration.paper(), form="paper"))
    rng = np.random.default_rng(1)
    headings = ["photo", "tuned-0.30, 6.0 ms", "tuned-0.45, 9.0 ms", "target"]
    examples = [
        (f"builtin-0 {RUDE}, frame {n}", {h: rng.random((12, 16, 3), np.float32) for h in headings})
        for n in range(2)
    ]
    effects = [
        Effect("scale", 2, 1, 1.1, 0.6),
        Effect(f"views {RUDE}", None, 4, 0.95, 1.3),
        Effect("bounces", False, True, 1.0, 0.9),
    ]
    record = {
        "device": "cpu: cpu",
        "versions": {"jax": "0.10.2"},
        "prediction errors": [0.02, 0.3, 0.06],
        "kept": [],
        "cases": 16,
        RUDE: RUDE,
    }
    whole = Tuned(best[0].configuration, best, budgets, found, references, trials(), effects, examples, record)
    return dataclasses.replace(whole, **changes)


# ---- configurations ----


def test_a_configuration_for_each_budget(tmp_path: Path) -> None:
    tuned = fake([FPS60, FPS100, RUDEST, Budget("100fps", 10.0)])
    files = report.write_configurations(tmp_path, tuned)
    names = ["", "-60fps", "-100fps", "-b-amp-x-script", "-100fps-2"]
    assert files == [tmp_path / f"configuration{name}.json" for name in names]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    for path, best in zip(files[1:], tuned.best, strict=True):
        assert Configuration.from_json(path.read_text()).to_json() == best.configuration.to_json()
    assert report.write_configurations(tmp_path, fake([FPS60])) == [tmp_path / "configuration.json"]


def test_all_files(tmp_path: Path) -> None:
    (tmp_path / "front").mkdir()
    (tmp_path / "front" / "tuned-0.11.json").write_text("of an earlier run")
    report.write_results(tmp_path, fake([FPS60]))
    names = {"configuration.json", "front", "pareto.csv", "pareto.png", "contact_sheet.png", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == names
    front = sorted(path.name for path in (tmp_path / "front").iterdir())
    assert front == ["tuned-0.30.json", "tuned-0.45.json", "tuned-b-amp-x-script.json"]
    assert Configuration.open(str(tmp_path / "front" / front[0])).scale == 2
    assert read_image(tmp_path / "pareto.png").shape[1] == 1800
    assert read_image(tmp_path / "contact_sheet.png").shape[1] == 4 * 324 + 4


def test_the_table_reads_back(tmp_path: Path) -> None:
    tuned = fake([FPS60])
    report.write_pareto_csv(tmp_path / "pareto.csv", tuned)
    with (tmp_path / "pareto.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [*report.CSV_COLUMNS, *report.score_columns()]
    by_name = {row["name"]: row for row in rows}
    assert len(by_name) == len(rows) == 3 + 3 + len(tuned.trials)
    best = by_name["tuned-60fps"]
    assert (best["best_for"], best["kind"], best["front"], best["choices"]) == (
        "60 fps",
        "tuned",
        "yes",
        "guide none",
    )
    assert float(best["relative_loss"]) == 0.9 and float(best["relative_time"]) == 0.45
    disturbed = dataclasses.replace(tuned.best[0], time=FrameTime(9.0, 19.0, 20.0, 0.45, quiet_p95=9.5))
    row = report._candidate_row(tuned, "tuned", disturbed)
    assert (float(row["p95_ms"]), float(row["judged_p95_ms"])) == (19.0, 9.5)
    assert float(best["median_ms"]) == 9 and float(best["held_out_relative"]) == pytest.approx(0.918)
    assert by_name["paper"]["kind"] == "paper" and by_name["default"]["kind"] == "preset"
    trial = by_name["trial-2"]
    assert trial["kind"] == "trial: combining" and float(trial["relative_time"]) == pytest.approx(0.43)
    assert float(trial["relative_loss"]) == pytest.approx(0.92**0.5, rel=1e-5) and trial["median_ms"] == ""
    assert by_name["trial-1"]["relative_time"] == "" and "scale" in trial["choices"]


def test_every_candidate_once() -> None:
    """The best is on the front under another name, and may be a reference."""
    tuned = fake([FPS60])
    assert [c.name for _, c in candidates(tuned)] == [
        *("tuned-0.30", "tuned-60fps", f"tuned-{RUDE}"),
        *("fast", "default", "paper"),
    ]
    reference = next(c for c in tuned.references if c.name == "fast")
    timed = dataclasses.replace(reference, time=FrameTime(1.0, 2.0, 20.0, 0.05))
    again = candidates(dataclasses.replace(tuned, best=[timed], front=[reference]))
    assert [(kind, c.name) for kind, c in again] == [("preset", "fast"), ("preset", "default"), ("paper", "paper")]
    assert again[0][1].time.median == 1.0, "one median for one configuration: the last one"


def test_a_bargain_is_told() -> None:
    tuned = fake([FPS60])
    cheap = dataclasses.replace(tuned.front[0], tuning=tuned.best[0].tuning | {"relative": 0.905})
    cheap = dataclasses.replace(cheap, time=FrameTime(4.0, 4.2, 20.0, 0.2))
    assert not any("bargain" in line for line in report.summary(dataclasses.replace(tuned, front=tuned.front[-1:])))
    said = report.summary(dataclasses.replace(tuned, front=[cheap]))[2]
    assert "takes 4.00 ms, 2.2 times less, for 0.6 % more loss" in said


def test_the_result_is_far_faster_where_that_costs_next_to_nothing() -> None:
    tuned = fake([FPS60], ms=14.0)
    slow, cheap = tuned.front[1], dataclasses.replace(tuned.front[0], tuning=scores(0.903))
    assert best_within(FPS60, [slow, cheap]) is cheap
    dear = dataclasses.replace(cheap, tuning=scores(0.906))
    assert best_within(FPS60, [slow, dear]) is slow, "more than half a per cent of the loss"
    assert best_within(FPS60, [slow, dataclasses.replace(cheap, time=slow.time)]) is slow
    said = report.summary(dataclasses.replace(tuned, best=[cheap], front=[cheap, slow]))
    assert any("tuned-0.45 has 0.3 % less loss within the budget, for 2.3 times the time" in line for line in said)


def test_the_diffusion_alone_leaves_schedules(tmp_path: Path) -> None:
    record = fake([FPS60]).record | {"stage": "cascade", "device": "Phone"}
    tuned = fake([FPS60, FPS100], record=record)
    report.write_results(tmp_path, tuned)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"schedule.json", "schedule-60fps.json", "schedule-100fps.json"} <= names
    assert "configuration.json" not in names
    for path in (tmp_path / "schedule.json", *(tmp_path / "front").iterdir()):
        Schedule.from_json(path.read_text(encoding="utf-8")).check()
    far = [dataclasses.replace(c, time=FrameTime(9.0, 9.9, 20.0, 0.45, predicted=True)) for c in tuned.best]
    said = report.summary(dataclasses.replace(tuned, best=far))
    assert "takes, for Phone predicted, not timed, 9.00 ms (p95 9.90 ms)" in said[0]


# ---- sentences ----


def test_the_first_sentence_says_it_all() -> None:
    said = report.summary(fake([FPS60]))
    assert said == [
        "60 fps = 16.67 ms: tuned-60fps takes 9.00 ms (p95 9.90 ms), 0.45 of the default's time; loss 8.2 % less "
        "than the default, PSNR 23.08 dB against 22.98 (held-out frames).",
        "It differs from the default in: guide none.",
        "Times of 3 proposed configurations were predicted with an error of 6.0 % (median), 30.0 % at worst.",
    ]


def test_a_missed_budget_is_said(tmp_path: Path) -> None:
    tuned = fake([FPS60, FPS100], ms=12.0)
    said = report.summary(tuned)
    late = (
        "100 fps = 10 ms could not be kept: measured p95 13.20 ms; "
        "tuned-100fps is the fastest of those that were judged."
    )
    assert [sentence for sentence in said if "could not" in sentence] == [late]
    report.write_results(tmp_path, tuned)
    words = "".join(parse((tmp_path / "report.html").read_text(encoding="utf-8")).text)
    assert late in words and words.count("could not be kept") == 2 and words.count("p95 kept") == 1


def test_sentences_where_less_is_known() -> None:
    said, choices = report.summary(fake([FPS60], held_out=False, references=[], record={}))
    assert said.endswith("time; loss 10.0 % less than the default, PSNR 23.10 dB (tuning frames).")
    assert choices == "It differs from the default in: guide none."


def test_a_result_that_is_the_default_says_so() -> None:
    tuned = fake([FPS60])
    best = [
        dataclasses.replace(c, configuration=dataclasses.replace(Configuration(), name=c.name)) for c in tuned.best
    ]
    assert "It is the default: nothing better was found." in report.summary(dataclasses.replace(tuned, best=best))


def test_an_unfinished_search_and_further_budgets_are_told() -> None:
    record = {"unfinished": True, "trials": 7, "further budgets": [0.5, 1.0]}
    said = report.summary(fake([FPS60], record=record))
    assert said[0].startswith("Unfinished, after 7 trials") and said[0].endswith("--resume goes on.")
    assert any(line.startswith("Searched for 1 budget and, to draw the front, for 0.5, 1 of") for line in said)


def test_a_disturbed_clock_is_told_once_with_both_times() -> None:
    tuned = fake([FPS60, FPS100], record={"disturbed": [40.0, 22.0]})
    busy = FrameTime(9.0, 19.0, 20.0, 0.45, quiet_p95=9.5, default_p95=40.0, default_quiet_p95=22.0)
    said = report.summary(dataclasses.replace(tuned, best=[dataclasses.replace(c, time=busy) for c in tuned.best]))
    assert "(p95 9.90 ms, of all rounds 19.00)" in said[0], "the ratio to the default says more than 9.50"
    (once,) = [line for line in said if "disturbed" in line]
    assert "the default's p95 was 40.00 ms, and 22.00 in the quieter half" in once
    assert not any("could not be kept" in line for line in said)


def test_choices_that_no_true_picture_could_judge_are_told() -> None:
    names = ["bounces", "bounce_gain"]
    for like in ("default", "balanced"):
        said = report.summary(fake([FPS60], record={"not searched": names, "not searched, as in": like}))
        (line,) = [line for line in said if line.startswith("Not searched: bounces, bounce_gain, for which")]
        assert f"{like}'s were taken; only the true pictures of --rooms can judge them." in line
    assert not any("Not searched" in line for line in report.summary(fake([FPS60], record={"not searched": []})))


def test_what_differs_from_the_default() -> None:
    assert configuration_text(Configuration()) == "the default"
    paper = described(Configuration.paper())
    assert "bounces" not in paper and paper["photo_light"] == "kept" and paper["shadow_pass"] == "1:8"
    none = SPACE.configuration(SPACE.complete({"shadow_pass": "none", "bounces": False}))
    text = configuration_text(none)
    assert "shadow_pass none" in text and "bounces off" in text and "shadow κ" not in text


# ---- plots ----


@pytest.mark.parametrize("held_out", [True, False])
def test_the_plot_shows_every_point_and_budget(held_out: bool) -> None:
    tuned = fake([FPS60, FPS100], held_out=held_out)
    figure = draw_front_plot(tuned)
    assert len(figure.axes) == 1 + held_out
    for axes in figure.axes:
        words = [text.get_text() for text in axes.texts]
        assert {"default", "fast"} <= set(words) and "tuned-0.30" not in words
        assert any(word.startswith("paper: 2.4") for word in words) and axes.get_ylim()[1] < 2.0, "far off"
        dashed = [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"]
        assert dashed == [budget.milliseconds for budget in tuned.budgets]
    assert len(trial_dots(tuned)) == 5 and trial_dots(tuned)[0] == (20.0, 1.0)


def test_effects_are_named() -> None:
    figure = draw_effects(fake([FPS60]).effects)
    assert {text.get_text() for text in figure.axes[0].texts} == {"scale 2", f"views {RUDE} all", "bounces off"}


# ---- page ----


@pytest.mark.slow
@pytest.mark.parametrize("held_out", [True, False])
def test_the_page_stands_alone(held_out: bool, tmp_path: Path) -> None:
    tuned = fake([FPS60, FPS100, RUDEST], held_out=held_out)
    report.write_results(tmp_path, tuned)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|@import|url\((?!#)", text)
    page = parse(text)
    words = "".join(page.text)
    for sentence in report.summary(tuned):
        assert sentence in words
    for _, known in candidates(tuned):
        assert known.name in words
    assert page.drawings == {"front", "effects"} and words.count("guide none") >= 3
    assert not re.search(r"<(?!b>|/script>)", re.sub(r'"use strict".*', "", words, flags=re.DOTALL))
    assert text.count('class="sortable"') == 3 and text.count("data:image/png") == 2 * 4
    assert {"front", "configurations", "candidates", "effects", "pictures", "trials", "record"} <= set(page.ids)


def test_a_bare_run_has_a_page(tmp_path: Path) -> None:
    report.write_results(
        tmp_path, fake([FPS60], held_out=False, references=[], trials=[], effects=[], examples=[], record={})
    )
    page = parse((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"effects", "pictures", "trials"} & set(page.ids) and page.drawings == {"front"}
    assert not (tmp_path / "contact_sheet.png").exists()


def test_nothing_is_left_where_writing_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="cannot write"):
        report.write_results(tmp_path / "gone", fake([FPS60]))
    assert not (tmp_path / "gone").exists()
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(InputError, match="disk full"):
        report.write_pareto_csv(tmp_path / "pareto.csv", fake([FPS60]))
    assert not list(tmp_path.iterdir())
