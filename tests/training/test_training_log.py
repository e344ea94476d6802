"""Settings and log of a training run: what is refused, what a resumed run forgets."""

import dataclasses
import json
from pathlib import Path

import pytest

from hyjax.training.log import TrainingLog
from hyjax.training.settings import TrainSettings, paper_settings
from hyjax.util.errors import InputError

SETTINGS = TrainSettings(iterations=10)


def run_of(folder: Path, iterations: int, settings: TrainSettings = SETTINGS) -> None:
    """A run of so many iterations that was then killed."""
    log = TrainingLog(folder, settings, resume=False)
    log.open(0, {"device": "cpu"})
    for i in range(1, iterations + 1):
        log.add(iteration=i, loss=1.0 / i)


def test_the_papers_recipe_is_what_its_training_section_says() -> None:
    recipe = paper_settings().check()
    assert (recipe.size, recipe.batch, recipe.iterations, recipe.factors) == (512, 8, 12_000, (32,))
    assert (recipe.steps_without_gradient, recipe.steps_with_gradient) == (20_000, 512)
    assert (recipe.learning_rate, recipe.decay, recipe.clip, recipe.through) == (1e-4, 0.9, 0.01, "steps")
    assert recipe.shading_weight == recipe.border_weight == 0


@pytest.mark.parametrize(
    "change, says",
    [
        ({"size": 100}, "size: 100"),
        ({"factors": (7,)}, "factors"),
        ({"factors": ()}, "factors"),
        ({"batch": 0}, "batch"),
        ({"iterations": 0}, "iterations"),
        ({"seed": 2**32}, "seed"),
        ({"size": 96, "factors": (12,)}, "factors: .* every level of paper-50: 16, 8, 4, 2"),
        ({"through": "magic"}, "through: 'magic' is unknown; use one of cascade, steps"),
        ({"schedule": "paper-5"}, "schedule"),
        ({"pairs": ()}, "pairs"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"lam": 0.3}, "lam"),
        ({"depth_weight": 0.0, "shading_weight": 0.0, "border_weight": 0.0}, "weights"),
        ({"border_weight": -1.0}, "weights"),
    ],
)
def test_unusable_settings_are_named(change: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        dataclasses.replace(SETTINGS, **change).check()


def test_a_folder_with_a_run_is_not_overwritten(tmp_path: Path) -> None:
    run_of(tmp_path, 3)
    with pytest.raises(InputError, match="--resume"):
        TrainingLog(tmp_path, SETTINGS, resume=False)
    assert len(TrainingLog(tmp_path, SETTINGS, resume=True).lines) == 3


def test_resuming_with_other_settings_names_the_first_that_differs(tmp_path: Path) -> None:
    run_of(tmp_path, 3)
    for change, message in (
        ({"batch": 8}, "that run had --batch 4 and this one has --batch 8"),
        ({"adjusted": False}, "that run had --adjusted and this one has --no-adjusted"),
        ({"validation": ("rooms", "b")}, "that run had no --validation and this one has --validation rooms b"),
        ({"validate_every": 7}, "--validate-every 7"),  # it decides which weights are the best so far
    ):
        with pytest.raises(InputError, match=message):
            TrainingLog(tmp_path, dataclasses.replace(SETTINGS, **change), resume=True)
    TrainingLog(tmp_path, dataclasses.replace(SETTINGS, iterations=20, checkpoint_every=7), resume=True)


def test_what_came_after_the_checkpoint_is_forgotten(tmp_path: Path) -> None:
    run_of(tmp_path, 5)
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"iteration": 6, "lo')  # killed in the middle of a line
    log = TrainingLog(tmp_path, SETTINGS, resume=True)
    log.open(3, {})
    log.add(iteration=4, loss=0.5)
    lines = [json.loads(text) for text in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == [1, 2, 3, 4] and lines[-1]["loss"] == 0.5


def test_best_is_the_lowest_validation_so_far(tmp_path: Path) -> None:
    log = TrainingLog(tmp_path, SETTINGS, resume=False)
    log.open(0, {})
    best = []
    for i, loss in enumerate((3.0, 2.0, 2.5, 1.0)):
        log.add(iteration=i, loss=9.0)
        log.add(iteration=i, validation={"loss": loss})
        best.append(log.last_is_best())
    assert best == [True, True, False, True]


@pytest.mark.parametrize(
    "line",
    [
        '{"iteration": "x"}',
        "[1]",
        '{"iteration": 1, "validation": {"loss": "x"}}',
        "9" * 5000,
    ],
)
def test_a_line_that_is_none_is_named(tmp_path: Path, line: str) -> None:
    run_of(tmp_path, 2)
    file = tmp_path / "log.jsonl"
    file.write_text(f"{line}\n{file.read_text()}")
    with pytest.raises(InputError, match=r"log\.jsonl: line 1 is not a line of a training run"):
        TrainingLog(tmp_path, SETTINGS, resume=True)


def test_an_unreadable_settings_file_ends_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text("{")
    with pytest.raises(InputError, match=r"settings\.json: not JSON"):
        TrainingLog(tmp_path, SETTINGS, resume=True)
