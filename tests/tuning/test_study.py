"""The study that a search is kept in: it goes on where it was, and refuses what is another's."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import need

from hyjax.tuning import study as study_module
from hyjax.tuning.evaluator import StudyEvaluator
from hyjax.tuning.replay import front_configurations
from hyjax.tuning.search import State, init, search, update
from hyjax.tuning.space import Choices, Space, key_of, structure
from hyjax.tuning.study import FILE_NAME, Study, kept_trials
from hyjax.tuning.trial import Trial, front_of_trials
from hyjax.util.errors import InputError

need("tune")

SPACE = Space.of(truth=True)
SETTINGS = {"cases": [[0, "noon", 3]], "seed": 0}


class Counting(StudyEvaluator):
    """Evaluator with a study and made-up numbers, which counts what it computes."""

    def __init__(self, study: Study) -> None:
        class Clock:
            def times(_, configurations: list[Any], repeats: int) -> list[Any]:
                self.computed += 1
                (configuration,) = configurations
                ratio = 0.5 + 0.5 / configuration.scale + 0.01 * len(configuration.schedule.levels)
                return [type("Time", (), {"ratio": ratio})()]

        super().__init__(SPACE, None, [(0, "noon", n) for n in range(8)], Clock(), study)  # type: ignore[arg-type]
        self.computed = 0

    def relative(self, configuration: Any, cases: Any) -> list[float]:
        self.computed += 1
        kappa = float(np.asarray(configuration.schedule.levels[0].kappa))
        return [1 + 0.1 * configuration.scale + kappa + 0.01 * index for _, _, index in cases]

    def refined(self, choices: Choices, batch: int) -> Choices:
        self.computed += 1
        return self.space.complete(choices | ({"kappa": 0.031} if "kappa" in choices else {}))

    def relaxed(self, choices: Choices, trial: Trial) -> Choices:
        self.computed += 1
        return self.space.complete(choices | {"cascade": "8:7 4:3", "kappa": (0.02, 0.03)})


def run(folder: Path | None, trials: int, *, most: float = math.inf, **options: Any) -> tuple[State, Counting]:
    """A search that breaks off after so many computations."""
    study = Study(folder, "frame", SETTINGS, **options)
    evaluator, state = Counting(study), init(SPACE, [2, 4, 8], trials, relaxes=1)
    for trial in study.trials:
        state = update(state, known := evaluator.known(trial))
        if trial.time is None:
            study.add(SPACE, known)

    def report(state: State, trial: Trial) -> None:
        study.add(SPACE, trial)
        if evaluator.computed >= most:
            raise KeyboardInterrupt

    return search(state, evaluator, [0.8], report=report), evaluator


@pytest.mark.slow
def test_an_interrupted_search_goes_on(tmp_path: Path) -> None:
    """And ends as one that was not interrupted, computing each thing once."""
    whole, alone = run(None, 14)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, 14, most=9)
    resumed, rest = run(tmp_path, 14, resume=True)
    assert {k: (t.losses, t.time) for k, t in resumed.trials.items()} == {
        k: (t.losses, t.time) for k, t in whole.trials.items()
    }
    assert 0 < rest.computed <= alone.computed - 8 and rest.study.trials
    again, nothing = run(tmp_path, 14, resume=True)
    assert nothing.computed == 0 and list(again.trials) == list(whole.trials)


def test_another_machine_measures_times_anew(tmp_path: Path) -> None:
    """Losses are kept: they hold anywhere."""
    first, _ = run(tmp_path, 8, machine="cpu")
    other, computed = run(tmp_path, 8, machine="gpu", resume=True)
    assert list(other.trials) == list(first.trials)
    structures = {structure(t.choices, SPACE) for t in first.trials.values()}
    assert computed.computed == len(structures) - 1, "that of the default is its own measure"
    assert run(tmp_path, 8, machine="cpu", resume=True)[1].computed == 0
    assert run(tmp_path, 8, machine="gpu", resume=True)[1].computed == 0


def test_kept_trials_are_those_of_the_search(tmp_path: Path) -> None:
    whole, _ = run(tmp_path, 10)
    found = {key_of(trial.choices): trial for trial in kept_trials(tmp_path / FILE_NAME)}
    assert found.keys() == whole.trials.keys()
    for key, trial in whole.trials.items():
        assert (found[key].losses, found[key].time, found[key].phase) == (trial.losses, trial.time, trial.phase)
    for path, name in ((tmp_path / FILE_NAME, "paper"), (tmp_path / "none.log", "frame")):
        with pytest.raises(InputError, match="no"):
            kept_trials(path, name)
    assert not (tmp_path / "none.log").exists()


def test_a_kept_front_is_a_few_configurations(tmp_path: Path) -> None:
    """Of the trials on all cases, from fast to good."""
    whole, _ = run(tmp_path, 14)
    made = front_configurations(kept_trials(tmp_path / FILE_NAME))
    front = front_of_trials(list(whole.trials.values()), cases=8)
    assert len(front) >= 2 and len(made) == min(3, len(front))
    assert [made[0].name, made[-1].name] == [f"tuned-{t.time:.2f}" for t in (front[0], front[-1])]
    assert made[0].to_json() == SPACE.configuration(front[0].choices, made[0].name).to_json()
    assert front_configurations([]) == []


def test_what_was_cut_short_is_not_kept(tmp_path: Path) -> None:
    study = Study(tmp_path, "frame", SETTINGS)
    assert study.remember("refined", lambda: {"kappa": 1}, expired=lambda: True) == {"kappa": 1}
    assert study.remember("refined", lambda: {"kappa": 2}) == {"kappa": 1}, "in this run"
    again = Study(tmp_path, "frame", SETTINGS, resume=True)
    assert again.remember("refined", lambda: {"kappa": 3}) == {"kappa": 3}
    assert Study(tmp_path, "frame", SETTINGS, resume=True).remember("refined", lambda: 4) == {"kappa": 3}


# ---- refusals ----


def refusal(folder: Path, settings: dict[str, Any], **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        Study(folder, "frame", settings, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_study_is_not_overwritten(tmp_path: Path) -> None:
    run(tmp_path, 4)
    assert "--resume" in refusal(tmp_path, SETTINGS)


def test_other_settings_are_refused(tmp_path: Path) -> None:
    run(tmp_path, 4)
    said = refusal(tmp_path, SETTINGS | {"seed": 1}, resume=True)
    assert "seed 0" in said and "has 1" in said


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path, 4)
    monkeypatch.setattr(study_module, "VERSION", study_module.VERSION + 1)
    assert f"version {study_module.VERSION - 1}" in refusal(tmp_path, SETTINGS, resume=True)


@pytest.mark.parametrize("content", ["not a journal\n", '{"op_code": 99}\n', "[]\n", "\x00\xff\n", '{"a": 1}\n{"b'])
def test_a_damaged_journal_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text(content, encoding="utf-8")
    assert "is no journal of a study" in refusal(tmp_path, SETTINGS, resume=True)
    with pytest.raises(InputError, match="has no trials"):
        kept_trials(tmp_path / FILE_NAME)


def test_a_line_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    """A crash may leave one."""
    run(tmp_path, 6)
    text = (tmp_path / FILE_NAME).read_text(encoding="utf-8")
    (tmp_path / FILE_NAME).write_text(text[:-20], encoding="utf-8")
    whole, evaluator = run(tmp_path, 6, resume=True)
    assert len(whole.trials) == 6 and evaluator.computed <= 4
    assert all(json.loads(line) for line in text.splitlines())


def test_without_optuna(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "optuna" in refusal(tmp_path, SETTINGS)
