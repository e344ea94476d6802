"""What an unfinished search leaves: the best so far, or the fastest, and a report."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import pytest
from extras import need
from page_checks import parse

from hyjax.configuration import PRESETS, Configuration
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.monitor import RunMonitor
from hyjax.tuning.proof import best_within, prove_in_time
from hyjax.tuning.report_page import page
from hyjax.tuning.report_text import candidates, summary
from hyjax.tuning.request import Budget
from hyjax.tuning.result import Candidate
from hyjax.tuning.run import Run
from hyjax.tuning.search import State, init, propose, update
from hyjax.tuning.settings import FrameOptions, TuneSettings
from hyjax.tuning.space import Space
from hyjax.tuning.trial import Trial
from hyjax.tuning.unfinished import best_known, best_or_fastest, unfinished
from hyjax.util.errors import InputError

need("tune")
SPACE = Space.of(truth=True)
BASE = FrameTime(20.0, 22.0, 20.0, 1.0)
BUDGETS = [Budget("60 fps", 16.7), Budget("1000 fps", 1.0)]


def trials() -> list[Trial]:
    small, half = ({"scale": n} for n in (4, 2))
    return [
        Trial(SPACE.default, "default", (1.0, 1.0), 1.0),
        Trial(SPACE.complete(half), "start", (1.1, 1.1), 0.5),
        Trial(SPACE.complete(small), "start", (1.3, 1.2), 0.3),
    ]


def searched(count: int = 3) -> State:
    return functools.reduce(update, trials()[:count], init(SPACE, [2, 4], 20))


def test_the_best_within_the_budget_or_the_fastest() -> None:
    assert best_or_fastest(searched(), 0.75) == trials()[1]
    assert best_or_fastest(searched(), 0.05) == trials()[2], "none fits"
    assert best_or_fastest(init(SPACE, [2, 4], 20), 0.05) is None


def test_few_cases_flatter() -> None:
    """A trial that the first case likes best is not the best of those that went through more."""
    lucky = Trial(SPACE.complete({"scale": 3}), "screening", (0.8,), 0.4)
    state = update(searched(), lucky)
    assert best_known(state, 0.75) == best_or_fastest(state, 0.75) == trials()[1]
    assert best_known(state, 0.45) == trials()[2] and best_known(state, 0.05) is None
    assert best_known(update(init(SPACE, [1, 2], 20), lucky), 0.75) == lucky, "where none has"


def test_a_report_of_it_says_that_it_is_unfinished() -> None:
    tuned = unfinished(searched(), base=BASE, budgets=BUDGETS, limits=[0.75, 0.045], record={"stage": "frame"})
    assert [c.name for c in tuned.best] == ["tuned-60fps", "tuned-1000fps"] and tuned.configuration.scale == 2
    said = summary(tuned)
    assert said[0].startswith("Unfinished, after 3 trials")
    assert "tuned-60fps takes 10.00 ms (p95 11.00 ms), 0.50 of the default's time; loss 10.0 % more" in said[1]
    assert "1000 fps = 1 ms could not be kept" in " ".join(said)
    words = "".join(parse(page(tuned, [])).text)
    names = [c.name for _, c in candidates(tuned)]
    assert names == ["tuned-1000fps", "tuned-60fps", "default"], "each once"
    assert said[0] in words and "tuned-1000fps" in words and "SSIM" not in words


class Stage:
    """Stage of a frame whose pictures and times are known."""

    name, space, predicts, first, relaxes, turn = "frame", SPACE, False, 2, 0, 4
    cases, held_out = (0, 1), ()
    decisive = record = lambda _: {}
    references = lambda _: [Configuration()]  # noqa: E731
    limit = lambda _, budget, base: budget.milliseconds / base.p95  # noqa: E731
    base_time = lambda *_: BASE  # noqa: E731
    starts = lambda *_: [t.choices for t in trials()[1:]]  # noqa: E731
    check_reachable = lambda *_: None  # noqa: E731

    def __init__(self, end: BaseException) -> None:
        self.end, self.left = end, [dataclasses.replace(t) for t in trials()]

    def evaluator(self, *_: object) -> "Stage":
        return self

    cost = None

    def __call__(self, trial: Trial) -> Trial:
        if not self.left:
            raise self.end
        known = self.left.pop(0)
        assert known.choices == trial.choices
        return dataclasses.replace(trial, losses=known.losses, time=known.time)


@pytest.mark.parametrize(
    "end", [KeyboardInterrupt(), InputError("study.log: cannot write (No space left on device)")]
)
def test_a_run_that_ends_early_leaves_the_best_so_far(
    end: BaseException, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    settings = TuneSettings(frame=FrameOptions(trials=20), fps=(60.0,), out=tmp_path, quiet=True)
    run = Run(Stage(end), settings, BUDGETS[:1], RunMonitor(None, False))  # type: ignore[arg-type]
    with pytest.raises(type(end)) as caught:
        run.run()
    said = str(caught.value) if isinstance(end, InputError) else capsys.readouterr().err
    assert "--resume goes on" in said and f"{tmp_path / 'configuration.json'} is the best so far" in said
    assert Configuration.open(str(tmp_path / "configuration.json")).scale == 2
    words = "".join(parse((tmp_path / "report.html").read_text(encoding="utf-8")).text)
    assert "Unfinished, after 3 trials" in words


@pytest.mark.parametrize("timed", [True, False])
def test_the_default_is_there_before_the_first_trial(
    timed: bool, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Stage(KeyboardInterrupt())
    stage.left = []
    if not timed:
        monkeypatch.setattr(stage, "base_time", stage)
    settings = TuneSettings(frame=FrameOptions(trials=20), fps=(60.0,), out=tmp_path, quiet=True)
    with pytest.raises(KeyboardInterrupt):
        Run(stage, settings, BUDGETS[:1], RunMonitor(None, False)).run()  # type: ignore[arg-type]
    assert "configuration.json is the best so far" in capsys.readouterr().err
    assert Configuration.open(str(tmp_path / "configuration.json")).scale == 1
    assert not (tmp_path / "report.html").exists()


def test_a_budget_is_refused_after_the_first_candidates(tmp_path: Path) -> None:
    stage, asked = Stage(KeyboardInterrupt()), list[object]()

    def refuse(*arguments: object) -> None:
        asked.append(arguments)
        raise InputError("budget 1 ms: out of reach")

    stage.check_reachable = refuse  # type: ignore[method-assign, assignment]
    settings = TuneSettings(frame=FrameOptions(trials=20), fps=(1000.0,), out=tmp_path, quiet=True)
    with pytest.raises(InputError, match=r"^budget 1 ms: out of reach; .*configuration\.json is the best so far"):
        Run(stage, settings, BUDGETS[1:], RunMonitor(None, False)).run()  # type: ignore[arg-type]
    assert not stage.left and len(asked) == 1
    assert Configuration.open(str(tmp_path / "configuration.json")).scale == 4, "the fastest"


def test_the_default_is_the_first_trial() -> None:
    state, trial = propose(init(SPACE, [2, 4], 20), [0.5]) or (None, None)
    assert state is not None and trial is not None and trial.choices == SPACE.default


def test_a_configuration_has_one_time_for_all_budgets() -> None:
    """The best for two budgets is timed once more once; one that no longer fits then is no best."""
    stage, asked = Stage(KeyboardInterrupt()), list[str]()

    class Clock:
        def times(self, configurations: Sequence[Configuration], *_: object, **__: object) -> list[FrameTime]:
            asked.extend(configuration.name for configuration in configurations)
            return [FrameTime(30.0, 33.0, 40.0, 0.75) for _ in configurations]

    stage.clock = Clock()  # type: ignore[attr-defined]
    budgets = [Budget("25 fps", 40.0), Budget("20 fps", 50.0), Budget("50 fps", 20.0)]
    run = Run(stage, TuneSettings(fps=(25.0,)), budgets, RunMonitor(None, False))  # type: ignore[arg-type]
    slow, fast = (
        Candidate(dataclasses.replace(Configuration(), name=name), {"relative": loss}, None, time)
        for name, loss, time in (
            ("slow", 0.9, FrameTime(28.0, 31.0, 40.0, 0.7)),
            ("fast", 1.0, FrameTime(15.0, 16.0, 40.0, 0.4)),
        )
    )
    found = run._timed_again([slow, fast])
    assert asked == ["slow", "fast"] and [c.time.median for c in found] == [30.0, 30.0]
    assert found[0].tuning is slow.tuning and best_within(budgets[0], found).name == "slow"


@dataclasses.dataclass
class FakeStage:
    """Stage of known times, in milliseconds."""

    milliseconds: dict[str, float]
    base = Configuration()
    cases = held_out = (0,)

    @property
    def judge(self) -> "FakeStage":
        return self

    @property
    def clock(self) -> "FakeStage":
        return self

    def scores(self, configuration: Configuration, cases: Sequence[int]) -> list[dict[str, float]]:
        return [{"loss": 1.0} for _ in cases]

    def times(self, configurations: Sequence[Configuration], rounds: int, most_seconds: float) -> list[FrameTime]:
        return [
            FrameTime(each, each, 20.0, each / 20) for each in (self.milliseconds[c.name] for c in configurations)
        ]


@pytest.mark.parametrize(("tuned", "proven"), [(30.0, ["default", "fast"]), (8.0, ["default"])])
def test_the_fastest_preset_is_tried_where_nothing_else_keeps_the_budget(
    tuned: float, proven: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunMonitor, "over", lambda monitor: True)
    stage = FakeStage({"tuned-1": tuned, "default": 20.0, "quality": 25.0, "balanced": 12.0, "fast": 9.0})
    candidate = dataclasses.replace(Configuration(), name="tuned-1")
    references = [stage.base, *map(Configuration.preset, PRESETS)]
    monitor = RunMonitor(60.0, progress=False)
    _, known, left = prove_in_time([candidate], references, stage, [Budget("100 fps", 10.0)], monitor)  # type: ignore[arg-type]
    assert [each.name for each in known] == proven
    assert left == [name for name in PRESETS if name not in proven]
    several = [Budget("10 fps", 100.0), Budget("100 fps", 10.0)]
    _, known, _ = prove_in_time([candidate, candidate], references, stage, several, monitor)  # type: ignore[arg-type]
    assert [each.name for each in known] == proven, "the tightest"
