"""A tuning run from end to end, in small pictures and on a clock that always says the same; once a real one."""

import csv
import dataclasses
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clocks import machine_time, steady_clock
from extras import need
from reference.seven_scenes_export import export_seven_scenes

from hyjax import InputError, Schedule
from hyjax import tune_schedule as tune
from hyjax.cli import main
from hyjax.core.schedule import GUIDED_FIDELITY
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.data.capture import Capture
from hyjax.tuning.cascade import CascadeStage
from hyjax.tuning.evaluator import CascadeEvaluator
from hyjax.tuning.factors import schedule_key
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.relaxation import FIDELITY_RANGE
from hyjax.tuning.report_text import summary
from hyjax.tuning.request import parse_budgets, split_frames
from hyjax.tuning.result import Tuned
from hyjax.tuning.settings import FrameOptions, TuneScene, TuneSettings
from hyjax.tuning.study import FILE_NAME, kept_trials
from hyjax.tuning.trial import Trial
from hyjax.util.images import read_image

need("tune")

SIZE = (48, 64)  # a factors of two levels: the gradient is quick to compile
OPTIONS: dict[str, Any] = {
    "budget_ms": 3.0,
    "frames": "0:2",
    "holdout": "3",
    "size": f"{SIZE[1]}x{SIZE[0]}",
    "frame": FrameOptions(trials=10),
    "extra": False,
    "quiet": True,
}
SCENE_OPTIONS = {field.name for field in dataclasses.fields(TuneScene)} - {"capture"}


def run_tune(*, capture: Capture, budget_ms: Any, **options: Any) -> Tuned:
    """`tune` with all options by name, as on the command line."""
    scene = TuneScene(**{name: options.pop(name) for name in SCENE_OPTIONS & options.keys()})
    return tune(settings=TuneSettings(scene, **options), budget_ms=budget_ms, capture=capture)


ENVIRONMENT = dict(os.environ)
"""With the user's cache folder, where the room is."""


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory: pytest.TempPathFactory, room: RoomCapture) -> Iterator[dict[str, Any]]:
    """Options for quick runs that keep their table to themselves: the steady clock, meshes as files."""
    folder = tmp_path_factory.mktemp("tune")
    rough = room.reference().copy()
    rough.vertices = rough.vertices + np.random.default_rng(0).normal(scale=0.01, size=rough.vertices.shape)
    rough.export(folder / "rough.ply")
    room.reference().export(folder / "true.ply")
    with pytest.MonkeyPatch.context() as patch:
        steady_clock(patch)
        patch.setenv("HYJAX_CACHE", str(folder / "cache"))
        yield OPTIONS | {
            "capture": room,
            "mesh": str(folder / "rough.ply"),
            "target": str(folder / "true.ply"),
            "repair_mesh": True,
        }


@pytest.fixture(scope="module")
def tuned(surroundings: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> tuple[Tuned, Path]:
    """Two budgets, one run, never interrupted."""
    out = tmp_path_factory.mktemp("whole") / "out"
    return run_tune(**surroundings | {"budget_ms": (3.0, 1.5), "out": out}), out


def test_everything_is_written(tuned: tuple[Tuned, Path]) -> None:
    result, out = tuned
    names = {path.name for path in out.iterdir()}
    assert {"schedule.json", "schedule-3ms.json", "schedule-1.5ms.json", "front", FILE_NAME} <= names
    assert {"pareto.csv", "pareto.png", "report.html", "contact_sheet.png"} <= names
    assert not [name for name in names if ".part" in name]
    assert Schedule.from_json((out / "schedule.json").read_text()).to_json() == result.schedule.to_json()
    rows = list(csv.DictReader((out / "pareto.csv").read_text().splitlines()))
    assert {"default", "naive-50"} <= {row["name"] for row in rows}
    assert {label for row in rows for label in row["best_for"].split(", ")} - {""} == {"3 ms", "1.5 ms"}
    for path in (out / "front").iterdir():
        Schedule.from_json(path.read_text()).check()
    page = (out / "report.html").read_text()
    assert "Tuned schedules" in page and "naive-50" in page
    assert read_image(out / "contact_sheet.png").ndim == 3


def test_each_budget_is_kept(tuned: tuple[Tuned, Path]) -> None:
    result, _ = tuned
    assert [c.name for c in result.best] == ["tuned-3ms", "tuned-1.5ms"]
    for budget, best in zip(result.budgets, result.best):
        expected = machine_time(schedule_key(best.configuration.schedule))
        assert best.time.median == pytest.approx(expected) and not best.time.predicted
        assert best.time.p95 <= budget.milliseconds
    assert result.record["prediction errors"] and max(result.record["prediction errors"]) < 0.1
    assert result.schedule is result.best[0].configuration.schedule
    assert result.best[0].tuning["loss"] <= result.best[1].tuning["loss"]
    assert result.best[0].tuning["relative"] < 1.0
    assert result.best[0].held_out is not None and np.isfinite(result.best[0].held_out["loss"])


def test_what_is_tuned_has_the_form_of_our_preset(tuned: tuple[Tuned, Path]) -> None:
    result, _ = tuned
    for candidate in [*result.best, *result.front]:
        schedule = candidate.configuration.schedule
        assert (schedule.pooling, schedule.upsampling, schedule.norm) == ("guide", "guide", "l2")
        assert all(FIDELITY_RANGE[0] <= x.fidelity <= FIDELITY_RANGE[1] for x in schedule.levels)
    alphas = [float(x.fidelity) for x in result.schedule.levels]
    assert any(abs(alpha / GUIDED_FIDELITY - 1) > 1e-3 for alpha in alphas), "tuned, too"


def test_baselines_are_timed_and_judged(tuned: tuple[Tuned, Path]) -> None:
    result, _ = tuned
    assert [c.name for c in result.references] == ["default", "naive-50", "naive-1000"]
    for reference in result.references:
        key = schedule_key(reference.configuration.schedule)
        assert reference.time.median == pytest.approx(machine_time(key))


def test_losses_of_trials_are_those_of_the_pipeline(tuned: tuple[Tuned, Path]) -> None:
    """The relaxed cascade of whole steps, by which trials are judged, is what `relight` runs."""
    result, _ = tuned
    front = next(c for c in result.front if c.name.startswith("tuned-"))
    losses = [trial.loss for trial in result.trials]
    assert min(losses) == pytest.approx(min(c.tuning["relative"] for c in result.front), rel=0.02)
    assert front.tuning["relative"] <= 1.0


def test_the_record_says_what_was_done(tuned: tuple[Tuned, Path], room: RoomCapture) -> None:
    result, _ = tuned
    names = [room[i].name for i in range(6)]
    assert result.record["frames"] == {"tuned on": names[:2], "held out": [names[3]]}
    assert result.record["stage"] == result.stage == "cascade" and result.record["settings"]["seed"] == 0
    assert "calibrated anew" in result.record["latency"]["table"]
    phases = {trial.phase for trial in result.trials}
    assert {"default", "start", "ranges", "relaxed"} <= phases
    assert result.trials[0].phase == "default", "the first trial costs nothing but its losses"


def schedules(out: Path) -> str:
    return (out / "schedule.json").read_text() + (out / "schedule-1.5ms.json").read_text()


def run_again(surroundings: dict[str, Any], out: Path, **options: Any) -> str:
    run_tune(**surroundings | {"budget_ms": (3.0, 1.5), "out": out} | options)
    return schedules(out)


def test_same_seed_same_table_same_schedules(
    tuned: tuple[Tuned, Path], surroundings: dict[str, Any], tmp_path: Path
) -> None:
    assert run_again(surroundings, tmp_path / "out") == schedules(tuned[1])


@pytest.mark.slow
@pytest.mark.parametrize("after", [1, 6])
def test_broken_off_and_resumed(
    after: int,
    tuned: tuple[Tuned, Path],
    surroundings: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
) -> None:
    out, left, call = tmp_path / "out", [after], CascadeEvaluator.__call__

    def breaking(self: CascadeEvaluator, trial: Trial) -> Trial:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return call(self, trial)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(CascadeEvaluator, "__call__", breaking)
        run_again(surroundings, out)
    # What is there is whole and can be used.
    Schedule.from_json((out / "schedule.json").read_text()).check()
    assert not [path for path in out.rglob("*") if ".part" in path.name]
    said = capsys.readouterr().err
    assert "--resume goes on" in said and "schedule.json is the best so far" in said
    assert run_again(surroundings, out, resume=True) == schedules(tuned[1])


def test_a_finished_run_resumed_computes_nothing(
    tuned: tuple[Tuned, Path], surroundings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, out = tuned
    before, want = kept_trials(out / FILE_NAME, "cascade"), schedules(out)
    monkeypatch.setattr(CascadeStage, "polished", None)
    monkeypatch.setattr(CascadeEvaluator, "__call__", None)
    assert run_again(surroundings, out, resume=True) == want
    assert kept_trials(out / FILE_NAME, "cascade") == before


def test_time_is_up_at_once(surroundings: dict[str, Any], tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    result = run_tune(**surroundings | {"time_limit": 1e-3, "out": tmp_path / "out"})
    assert result.best[0].time.p95 <= 3.0
    assert "have passed before the search" in caplog.text
    assert [candidate.name for candidate in result.references] == ["default"], "others are left out"
    assert (tmp_path / "out" / "report.html").is_file()
    assert "--resume with more time goes on" in summary(result)[-1]


def test_each_budget_is_answered_when_the_time_is_over(
    surroundings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search came to its end; of what it found, the best for the budgets asked and the default are proven."""
    monkeypatch.setattr(RunMonitor, "over", lambda monitor: True)
    result = run_tune(**surroundings | {"time_limit": 1e6, "budget_ms": (6.0, 1.2), "extra": True})
    assert result.best[0].time.p95 <= 6.0 and result.best[1].time.p95 <= 1.2
    assert [candidate.name for candidate in result.references] == ["default"]
    (told,) = [line for line in summary(result) if "no time to time and judge" in line]
    assert "naive-1000" in told and not any("time was up" in line for line in summary(result))


def test_without_a_folder_nothing_is_written(
    surroundings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_tune(**surroundings).best[0].time.p95 <= 3.0
    assert not list(tmp_path.iterdir())


def test_towards_convergence(surroundings: dict[str, Any]) -> None:
    """The target is the same mesh diffused for 1000 steps: more steps come closer."""
    result = run_tune(**surroundings | {"target": "converged", "budget_ms": (6.0, 1.2)})
    assert "1000 steps" in result.record["meshes"]
    assert result.best[0].tuning["loss"] < result.best[1].tuning["loss"]
    assert result.best[0].time.p95 <= 6.0
    naive = {c.name: c for c in result.references}
    assert naive["naive-1000"].tuning["loss"] < 1e-6


def test_extra_budgets_draw_the_curve(surroundings: dict[str, Any]) -> None:
    result = run_tune(**surroundings | {"extra": True, "frame": FrameOptions(trials=20)})
    assert len(result.front) > 1
    losses, times = [c.tuning["relative"] for c in result.front], [c.time.median for c in result.front]
    assert times == sorted(times) and losses == sorted(losses, reverse=True)
    assert len(result.best) == 1 and result.best[0].time.p95 <= 3.0


def test_a_clock_that_says_more_than_the_table(surroundings: dict[str, Any], tmp_path: Path) -> None:
    """The machine became slower after the table was made: what is returned still fits, on the clock."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
        run_tune(**surroundings | {"time_limit": 1e-3})  # makes the table
        steady_clock(patch, slowness=1.25)  # within what the probe tolerates
        result = run_tune(**surroundings)
    assert "from the cache" in result.record["latency"]["table"]
    best = result.best[0]
    assert best.name == "tuned-3ms" and best.time.p95 <= 3.0
    expected = 1.25 * 1.1 * machine_time(schedule_key(best.configuration.schedule))
    assert best.time.p95 == pytest.approx(expected)


# ---- what is asked for ----


def test_budgets() -> None:
    got = parse_budgets([60, 30.0], [4, 60])
    assert [(b.label, round(b.milliseconds, 3)) for b in got] == [
        ("60 fps", 16.667),
        ("30 fps", 33.333),
        ("4 ms", 4.0),
        ("60 ms", 60.0),
    ]
    assert [b.label for b in parse_budgets([60, 60.0], [])] == ["60 fps"]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 24, 1000])
def test_frames_by_default(count: int) -> None:
    chosen, held = split_frames(count, None, None)
    assert chosen and len(chosen) <= 4 and len(held) <= 4 and not set(chosen) & set(held)
    assert all(0 <= i < count for i in [*chosen, *held])
    if count > 1:
        assert held and max(chosen) < min(held), "later frames are held out, and none beside them tuned on"


def test_frames_as_asked() -> None:
    assert split_frames(24, "0:6", "3") == ([0, 1, 2, 4, 5], [3])
    chosen, held = split_frames(24, None, "0:4")
    assert held == [0, 1, 2, 3] and chosen[0] == 4 and chosen[-1] == 23
    with pytest.raises(InputError, match="held out, none is left to tune on"):
        split_frames(24, None, "all")


# ---- the command ----


@pytest.fixture
def folder(room: RoomCapture, tmp_path: Path) -> Path:
    """The first four frames in the 7-Scenes layout, without depth."""
    return export_seven_scenes([room[i] for i in range(4)], room.up, tmp_path / "capture")


@pytest.mark.slow
def test_the_command_on_the_real_clock(folder: Path, surroundings: dict[str, Any], tmp_path: Path) -> None:
    """At 64x64; then the schedule that came out is relit with."""
    hyjax, out = str(Path(sys.executable).with_name("hyjax")), tmp_path / "out"
    meshes = ["--mesh", surroundings["mesh"], "--repair-mesh"]
    common = ["--quiet", "--capture", str(folder), "--size", "64", *meshes]
    command = [hyjax, "tune", *common, "--target", surroundings["target"], "--frames", "0", "--holdout", "3"]
    command += ["--stage", "cascade"]
    command += ["--budget-ms", "500", "--fps", "10", "--time-limit", "1", "--no-extra", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=400, check=False)
    assert done.returncode == 0, done.stderr
    assert "schedule.json" in done.stdout and "hyjax: time limit: " in done.stderr
    assert (out / "report.html").stat().st_size > 1000
    again = [hyjax, "relight", *common, "--frames", "1", "--schedule", str(out / "schedule.json")]
    again += ["--keep-photo-light", "--out", str(tmp_path / "relit")]
    done = subprocess.run(again, capture_output=True, text=True, env=ENVIRONMENT, timeout=400, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "relit" / "contact_sheet.png").is_file()


def test_the_command_hands_its_options_on(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    got: list[TuneSettings] = []

    def fake(settings: TuneSettings) -> None:
        got.append(settings)
        raise InputError("enough")

    monkeypatch.setattr("hyjax.tuning.tune.tune", fake)
    monkeypatch.setattr("hyjax.cli._keep_for_later", lambda: None)
    line = "tune --fps 60 30 --budget-ms 2.5 --stage frame --size 48x32 --frames 0:3 --seed 4 --no-extra --resume"
    monkeypatch.setattr(sys, "argv", ["hyjax", *line.split()])
    with pytest.raises(SystemExit) as exit_:
        main()
    assert exit_.value.code == 2 and capsys.readouterr().err == "hyjax: enough\n"
    scene = TuneScene(size="48x32", seed=4)
    want = {
        "fps": (60.0, 30.0),
        "budget_ms": (2.5,),
        "stage": "frame",
        "frames": "0:3",
        "extra": False,
        "resume": True,
    }
    assert got == [TuneSettings(scene, out=Path("tuned"), **want)]
