"""A tuning run from end to end, in small pictures and on a clock that always says the same; once a real one."""

import contextlib
import csv
import dataclasses
import functools
import os
import re
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.seven_scenes_export import export_seven_scenes

import hyjax
from hyjax import InputError, Schedule
from hyjax import tune_schedule as tune
from hyjax.cli import main
from hyjax.core.schedule import GUIDED_FIDELITY, guided_schedule
from hyjax.data.builtin_room import RoomCapture, load_room
from hyjax.data.capture import Capture
from hyjax.guide import load_guide
from hyjax.tuning import calibration
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.journal import NAME
from hyjax.tuning.relaxation import FIDELITY_RANGE
from hyjax.tuning.report_text import summary
from hyjax.tuning.request import parse_budgets, split_frames
from hyjax.tuning.result import Candidate, Milliseconds, Scores, Tuned
from hyjax.tuning.run import _Run
from hyjax.tuning.search import Effort, Search
from hyjax.tuning.settings import TuneScene, TuneSettings
from hyjax.tuning.workload import schedule_key
from hyjax.util import clock as latency
from hyjax.util.images import read_image

SIZE = (48, 64)  # a factors of two levels: the gradient is quick to compile
TINY = Effort(sampled=3, relaxed=1, iterations=3, rounded=3, polished=1, polishing=2, descents=1)
OPTIONS: dict[str, Any] = {
    "budget_ms": 3.0,
    "frames": "0:2",
    "holdout": "3",
    "size": f"{SIZE[1]}x{SIZE[0]}",
    "effort": TINY,
    "extra": False,
    "quiet": True,
}
SCENE_OPTIONS = {field.name for field in dataclasses.fields(TuneScene)} - {"capture"}


def run_tune(*, capture: Capture, effort: Effort = TINY, budget_ms: Any, **options: Any) -> Tuned:
    """`tune` with all options by name, as on the command line."""
    scene = TuneScene(**{name: options.pop(name) for name in SCENE_OPTIONS & options.keys()})
    return tune(settings=TuneSettings(scene, **options), budget_ms=budget_ms, capture=capture, effort=effort)


SMALL = Path(hyjax.__file__).parent / "guide" / "trained" / "small.safetensors"
ENVIRONMENT = dict(os.environ)
"""With the user's cache folder, where the room is."""


ROUGHNESS = 0.02
"""Of the steady clock: no sum of levels and steps gives its times exactly, as on a real machine."""


def machine_time(key: str) -> float:
    """Milliseconds of a schedule by its `schedule_key`: 0.5, 0.2 a level, and for each step 1 / factor².

    Twice that for the paper's form, of which the model of the searched form knows nothing; and a little more or
    less from schedule to schedule, by `ROUGHNESS`, which the additive model cannot know.
    """
    words = key.split()
    levels = [tuple(map(int, word.split(":"))) for word in words if ":" in word]
    form = 1.0 if "upsampling=guide" in words else 2.0
    rough = 1.0 + ROUGHNESS * np.sin(7.0 * sum(steps for _, steps in levels) + 3.0 * len(levels))
    return float(form * rough * (0.5 + sum(0.2 + steps / factor**2 for factor, steps in levels)))


def steady_clock(patch: pytest.MonkeyPatch, slowness: float = 1.0) -> None:
    """Schedules take what `machine_time` says, everything else 0.1 ms; nothing is compiled to be timed."""

    def compile_all(schedules: Sequence[Schedule], *_: object, **__: object) -> list[Callable[[], str]]:
        return [functools.partial(str, schedule_key(schedule)) for schedule in schedules]

    def measure_each(calls: Mapping[str, Callable[[], Any]], repeats: int, **_: object) -> dict[str, dict]:
        times = {}
        for name, call in calls.items():
            time = 0.1
            if isinstance(call, functools.partial) and call.func is str:
                time = slowness * machine_time(call.args[0])
            elif match := re.match(r"whole frame (.*) G-buffer \(", name):
                time = 0.6 + slowness * machine_time(match[1])
            times[name] = {"first_ms": 9.0, "count": repeats, "median_ms": time, "p95_ms": 1.1 * time}
        return times

    patch.setattr(calibration, "compile_all", compile_all)
    patch.setattr(latency, "measure_each", measure_each)


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
    assert {"schedule.json", "schedule-3ms.json", "schedule-1.5ms.json", "pareto.csv", "pareto.png"} <= names
    assert {"report.html", "contact_sheet.png", NAME, "front"} <= names
    assert not [path for path in out.rglob("*") if ".part" in path.name]
    for name, schedule in (("schedule.json", result.schedule), ("schedule-1.5ms.json", result.best[1].schedule)):
        assert Schedule.from_json((out / name).read_text()).to_json() == schedule.to_json()
    assert (out / "schedule-3ms.json").read_text() == (out / "schedule.json").read_text()
    for picture in ("pareto.png", "contact_sheet.png"):
        assert np.isfinite(read_image(out / picture)).all()
    with (out / "pareto.csv").open() as file:
        assert {"tuned-3ms", "tuned-1.5ms"} <= {row["name"] for row in csv.DictReader(file)}
    assert "</html>" in (out / "report.html").read_text()


def test_each_budget_is_kept(tuned: tuple[Tuned, Path]) -> None:
    result, _ = tuned
    assert [b.label for b in result.budgets] == ["3 ms", "1.5 ms"]
    for budget, best in zip(result.budgets, result.best, strict=True):
        assert best.measured is not None and best.measured.p95 <= budget.milliseconds
        assert best.predicted.p95 == pytest.approx(best.measured.p95, rel=0.05)
        assert best.name == f"tuned-{budget.slug}"
    timed = [*result.best, *result.front]
    exact = [c.predicted.p95 == pytest.approx(c.measured.p95, rel=1e-4) for c in timed]
    assert not all(exact), "the clock is not exactly the table's model"
    assert result.schedule is result.best[0].schedule
    assert result.best[0].tuning.loss <= result.best[1].tuning.loss
    assert result.best[0].held_out is not None and np.isfinite(result.best[0].held_out.loss)


def test_what_is_tuned_has_the_form_of_our_preset(tuned: tuple[Tuned, Path]) -> None:
    result, _ = tuned
    for candidate in [*result.best, *result.front]:
        schedule = candidate.schedule
        assert (schedule.pooling, schedule.upsampling, schedule.norm) == ("guide", "guide", "l2")
        assert all(FIDELITY_RANGE[0] <= x.fidelity <= FIDELITY_RANGE[1] for x in schedule.levels)
    alphas = [float(x.fidelity) for x in result.schedule.levels]
    assert any(abs(alpha / GUIDED_FIDELITY - 1) > 1e-3 for alpha in alphas), "tuned, too"


def test_baselines_of_another_form_are_not_predicted_by_the_model(tuned: tuple[Tuned, Path]) -> None:
    """The table knows the form that is searched; of others, what the clock said."""
    result, _ = tuned
    assert [c.name for c in result.baselines] == ["naive-50", "naive-1000"]
    for baseline in result.baselines:
        assert baseline.predicted == baseline.measured
        assert baseline.measured.median == pytest.approx(machine_time(schedule_key(baseline.schedule)))


def test_no_baseline_that_fits_is_better(surroundings: dict[str, Any]) -> None:
    """A budget that 50 steps at half resolution fit in, and 1000 do not."""
    result = run_tune(**surroundings | {"budget_ms": 32.0})
    fitting = [baseline for baseline in result.baselines if baseline.measured.p95 <= 32.0]
    assert [baseline.name for baseline in fitting] == ["naive-50"]
    assert result.best[0].tuning.loss <= fitting[0].tuning.loss
    assert result.best[0].name == "tuned-32ms" and result.best[0].tuning.loss < 0.99 * fitting[0].tuning.loss


def test_the_record_says_what_was_done(tuned: tuple[Tuned, Path], room: RoomCapture) -> None:
    result, _ = tuned
    names = [room[i].name for i in range(6)]
    assert result.record["frames"] == {"tuned on": names[:2], "held out": [names[3]]}
    assert result.record["stage"] == "cascade" and result.record["seed"] == 0
    assert "calibrated anew" in result.record["latency"]["table"]
    assert {entry["budget"] for entry in result.history} == {"3 ms", "1.5 ms"}
    seconds = [entry["seconds"] for entry in result.history]
    assert seconds == sorted(seconds)


def run_again(surroundings: dict[str, Any], out: Path, **options: Any) -> str:
    run_tune(**surroundings | {"budget_ms": (3.0, 1.5), "out": out} | options)
    return (out / "schedule.json").read_text() + (out / "schedule-1.5ms.json").read_text()


def schedules(out: Path) -> str:
    return (out / "schedule.json").read_text() + (out / "schedule-1.5ms.json").read_text()


def test_same_seed_same_table_same_schedules(
    tuned: tuple[Tuned, Path], surroundings: dict[str, Any], tmp_path: Path
) -> None:
    assert run_again(surroundings, tmp_path / "out") == schedules(tuned[1])


@contextlib.contextmanager
def broken_off(error: BaseException, after: int) -> Iterator[None]:
    """The search raises `error` when it reports for the `after`-th time."""
    original, left = Search.__init__, [after]

    def init(self: Search, *arguments: Any, report: Callable[[str, float], None], **options: Any) -> None:
        def counting(phase: str, loss: float) -> None:
            report(phase, loss)
            left[0] -= 1
            if not left[0]:
                raise error

        original(self, *arguments, report=counting, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Search, "__init__", init)
        yield


@pytest.mark.slow
@pytest.mark.parametrize("after", [1, 6])
def test_broken_off_and_resumed(
    after: int, tuned: tuple[Tuned, Path], surroundings: dict[str, Any], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with broken_off(KeyboardInterrupt(), after), pytest.raises(KeyboardInterrupt):
        run_again(surroundings, out)
    # What is there is whole and can be used.
    for name in ("schedule.json", "schedule-1.5ms.json"):
        Schedule.from_json((out / name).read_text()).check()
    assert "</html>" in (out / "report.html").read_text() and (out / "pareto.csv").stat().st_size
    assert not [path for path in out.rglob("*") if ".part" in path.name]
    before = len((out / NAME).read_text().splitlines())
    assert run_again(surroundings, out, resume=True) == schedules(tuned[1])
    assert (out / NAME).read_text().splitlines()[:before] != [] and before > 1


def test_a_finished_run_resumed_computes_nothing(
    tuned: tuple[Tuned, Path], surroundings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, out = tuned
    before, want = (out / NAME).read_bytes(), schedules(out)
    assert run_again(surroundings, out, resume=True) == want
    assert (out / NAME).read_bytes() == before


@pytest.mark.slow
def test_more_budgets_on_resuming_keep_what_is_there(
    tuned: tuple[Tuned, Path], surroundings: dict[str, Any], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_tune(**surroundings | {"out": out})
    first = (out / "schedule.json").read_text()
    run_again(surroundings, out, resume=True)
    assert (out / "schedule.json").read_text() == first and schedules(out) == schedules(tuned[1])


KILLED = """
import os, signal, sys
import pytest
sys.path[:0] = {tests!r}
from test_tune import OPTIONS, load_room, run_tune, steady_clock
from hyjax.tuning import search

class Killed(BaseException):
    def __init__(self):
        pass

steady_clock(pytest.MonkeyPatch())
original = search.Search.__init__
left = [5]

def init(self, *arguments, report, **options):
    def counting(phase, loss):
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)
    original(self, *arguments, report=counting, **options)

search.Search.__init__ = init
room = load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)
os.environ["HYJAX_CACHE"] = {cache!r}
from pathlib import Path
options = OPTIONS | dict(capture=room, mesh={mesh!r}, target={target!r}, repair_mesh=True)
run_tune(**options | dict(budget_ms=(3.0, 1.5), out=Path({out!r})))
"""


@pytest.mark.slow
def test_killed_and_resumed(tuned: tuple[Tuned, Path], surroundings: dict[str, Any], tmp_path: Path) -> None:
    out, cache = tmp_path / "out", os.environ["HYJAX_CACHE"]
    script = KILLED.format(
        tests=[str(Path(__file__).parents[k]) for k in (0, 1)],
        cache=cache,
        mesh=surroundings["mesh"],
        target=surroundings["target"],
        out=str(out),
    )
    command = [sys.executable, "-c", textwrap.dedent(script)]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=300, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    Schedule.from_json((out / "schedule.json").read_text()).check()
    assert len((out / NAME).read_text().splitlines()) > 2
    assert run_again(surroundings, out, resume=True) == schedules(tuned[1])


def test_time_is_up_at_once(surroundings: dict[str, Any], tmp_path: Path) -> None:
    result = run_tune(**surroundings | {"time_limit": 1e-3, "out": tmp_path / "out"})
    assert result.best[0].measured.p95 <= 3.0
    assert (tmp_path / "out" / "report.html").is_file()


def test_without_a_folder_nothing_is_written(
    surroundings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_tune(**surroundings).best[0].measured.p95 <= 3.0
    assert not list(tmp_path.iterdir())


def test_towards_convergence(surroundings: dict[str, Any]) -> None:
    """The target is the same mesh diffused for 1000 steps: more steps come closer."""
    result = run_tune(**surroundings | {"target": "converged", "budget_ms": (6.0, 1.2)})
    assert "1000 steps" in result.record["settings"]["meshes"]
    assert result.best[0].tuning.loss < result.best[1].tuning.loss
    assert 0.8 * 6.0 < result.best[0].measured.p95 <= 6.0, "more steps were better, and there was time for them"
    naive = {c.name: c for c in result.baselines}
    assert naive["naive-1000"].tuning.loss < 1e-6


def test_extra_budgets_draw_the_curve(surroundings: dict[str, Any]) -> None:
    result = run_tune(**surroundings | {"extra": True})
    assert len(result.front) > 1
    losses, times = [c.tuning.loss for c in result.front], [c.measured.median for c in result.front]
    assert times == sorted(times) and losses == sorted(losses, reverse=True)
    assert len(result.best) == 1 and result.best[0].measured.p95 <= 3.0


def test_a_clock_that_says_more_than_the_table(surroundings: dict[str, Any], tmp_path: Path) -> None:
    """The machine became slower after the table was made: what is returned still fits, on the clock."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
        run_tune(**surroundings | {"time_limit": 1e-3})  # makes the table
        steady_clock(patch, slowness=1.25)  # within what the probe tolerates
        result = run_tune(**surroundings)
    assert "from the cache" in result.record["latency"]["table"]
    best = result.best[0]
    assert best.measured.p95 <= 3.0 < 1.25 * 3.0
    assert best.measured.p95 == pytest.approx(1.25 * 1.1 * machine_time(schedule_key(best.schedule)))


# ---- what is asked for ----


@pytest.mark.slow
def test_a_learned_guide_tuned_together(surroundings: dict[str, Any], tmp_path: Path) -> None:
    result = run_tune(**surroundings | {"guide": "small", "joint": True, "out": tmp_path / "out"})
    told = result.record["joint"]
    for frames in ("tuning", "held out"):
        before, after = told[frames]
        assert np.isfinite([*before.values(), *after.values()]).all()
    before, after = told["tuning"]
    assert after["loss"] < before["loss"]
    schedule = Schedule.from_json((tmp_path / "out" / "joint.json").read_text())
    assert [level.factor for level in schedule.levels] == [level.factor for level in result.schedule.levels]
    shipped, own = load_guide(SMALL), load_guide(tmp_path / "out" / "guide.safetensors")
    assert own.fingerprint != shipped.fingerprint
    picture = np.random.default_rng(0).random((*SIZE, 3), np.float32)
    np.testing.assert_allclose(own.trunk(picture), shipped.trunk(picture), atol=1e-5)
    assert "guide.safetensors" in summary(result)[-1]


def test_guide_and_schedule_start_from_what_the_search_could_have_found() -> None:
    """Of its form, and with no more steps than the relaxation can have: their gradients are the relaxation's."""
    run = _Run(None, [], [], None, [], {})  # type: ignore[arg-type]
    time = Milliseconds(1.0, 1.0)
    schedules = [
        *(Schedule.preset("paper-50"), guided_schedule([(2, MOST_STEPS + 1)], name="long")),
        *(Schedule.preset("hyjax"), guided_schedule([(2, 1)], name="worse")),
    ]
    run.baselines = [
        Candidate(schedule, time, time, Scores(0.1 * (i + 1), {"psnr": 20.0, "ssim": 0.9}), None)
        for i, schedule in enumerate(schedules)
    ]
    (budget,) = parse_budgets([], [2.0])
    assert run.best(budget).name == "paper-50" and run.best(budget, within_search=True).name == "hyjax"


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
    command += ["--budget-ms", "50", "5", "--time-limit", "1", "--no-extra", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=400, check=False)
    assert done.returncode == 0, done.stderr
    assert "schedule.json" in done.stdout and done.stderr == ""
    again = [hyjax, "relight", *common, "--frames", "1", "--schedule", str(out / "schedule.json")]
    again += ["--out", str(tmp_path / "relit")]
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
