"""The model of a frame's time: stages that are there, and what they leave."""

import numpy as np
import pytest

from experiments.frame_tuning import errors_left_out
from hyjax.tuning.space import Choices, Space
from hyjax.tuning.time_model import TimeModel, stage_work

SPACE = Space.of(truth=True)


def drawn(count: int, seed: int = 0) -> list[Choices]:
    rng = np.random.default_rng(seed)
    return [SPACE.default, *(SPACE.random(rng) for _ in range(count - 1))]


def test_work_is_that_of_the_sampling_that_runs() -> None:
    asked = SPACE.complete({"sampling": 4, "cascade": "2:4", "shadow_pass": "none"})
    runs = SPACE.complete({"sampling": asked["sampling"], "cascade": "2:4", "shadow_pass": "none"})
    assert asked["sampling"] < 4
    np.testing.assert_array_equal(stage_work(SPACE, asked), stage_work(SPACE, runs))
    fine, coarse = (stage_work(SPACE, SPACE.complete({"sampling": n})) for n in (1, 2))
    assert fine[1] == 1 and coarse[1] == 0.25 and fine[2] == 4 * 4 * coarse[2]


def test_work_of_cascades_is_counted_in_their_pixels() -> None:
    work = stage_work(SPACE, SPACE.complete({"cascade": "16:3 4:6", "shadow_pass": "none", "scale": 2}))
    assert work[-4] == pytest.approx((1 / 256 + 1 / 16) / 4) and work[-3] == pytest.approx((3 / 256 + 6 / 16) / 4)
    assert work[-2] == work[-1] == 0
    fine = stage_work(SPACE, SPACE.complete({"cascade": "16:3 4:6", "shadow_pass": "4:5 1:2", "sampling": 2}))
    assert fine[-2] == pytest.approx(1 / 16 + 1 / 4) and fine[-1] == pytest.approx(5 / 16 + 2 / 4), (
        "no finer than pixels"
    )


def test_times_that_are_a_sum_of_stages_are_predicted() -> None:
    choices, rng = drawn(40), np.random.default_rng(1)
    prices = np.abs(rng.normal(1.0, 0.5, len(stage_work(SPACE, SPACE.default))))
    times = [float(stage_work(SPACE, each) @ prices) for each in choices]
    times = [time / times[0] for time in times]
    model = TimeModel.fit(SPACE, choices[:30], times[:30])
    errors = np.abs(model(choices[30:]) / times[30:] - 1)
    assert np.median(errors) < 0.03 and np.all(model.prices >= 0)
    assert np.median(errors_left_out(SPACE, choices[:30], times[:30])) < 0.03


def test_one_trial_is_enough() -> None:
    model = TimeModel.fit(SPACE, [SPACE.default], [1.0])
    assert model([SPACE.default])[0] == pytest.approx(1.0, abs=0.05)
    assert 0 < model([SPACE.complete({"scale": 4})])[0] <= 1.1
