"""The cost model and its fit, on synthetic times."""

import numpy as np
import pytest
from reference.costs import TRUTH, random_steps

from hyjax.tuning.calibration import calibration_steps
from hyjax.tuning.cost_model import fit, leave_one_out
from hyjax.tuning.factors import FACTORS
from hyjax.util.errors import InputError


def test_the_cost_model_adds_up() -> None:
    assert TRUTH([0, 5, 0, 0, 20, 0]) == pytest.approx(1.2 + 0.3 + 0.8 + 5 * 0.003 + 20 * 0.076 + 0.2)
    assert TRUTH([0.5, 0, 0, 0, 0, 0]) == pytest.approx(1.2 + 0.5 + 0.001 + 3.5)


@pytest.mark.parametrize("steps", [[1, 2], [0] * 6, [1, 0, 0, 0, 0, -1], [1, 0, 0, 0, 0, float("nan")]])
def test_the_cost_model_refuses_what_is_no_schedule(steps: list[float]) -> None:
    with pytest.raises(InputError, match="steps: "):
        TRUTH(steps)


def test_the_fit_recovers_an_additive_model() -> None:
    steps = calibration_steps(FACTORS)
    model = fit(steps, [TRUTH(row) for row in steps])
    for row in random_steps():
        assert model(row) == pytest.approx(TRUTH(row), rel=1e-4)
    assert model.step == pytest.approx(TRUTH.step, rel=1e-2)
    assert min(model.finest[:-1]) == 0.0 or model.level[-1] == 0.0  # what all pay is in `fixed`
    assert leave_one_out(steps, [TRUTH(row) for row in steps]).max() < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_the_fit_withstands_outliers_in_a_tenth_of_the_times(seed: int) -> None:
    """Among the schedules that share their coefficients with others; a level's only evidence is beyond help."""
    rng = np.random.default_rng(seed)
    steps = calibration_steps(FACTORS)
    times = np.array([TRUTH(row) for row in steps]) * rng.normal(1.0, 0.01, len(steps))
    long = [i for i, row in enumerate(steps) if np.count_nonzero(row) > 2]
    times[rng.choice(long, len(steps) // 10, replace=False)] *= rng.uniform(1.5, 4.0, len(steps) // 10)
    model = fit(steps, times)
    errors = [abs(model(row) / TRUTH(row) - 1.0) for row in random_steps()]
    assert np.median(errors) < 0.05 and max(errors) < 0.2


def test_the_fit_never_goes_below_its_bound() -> None:
    steps = calibration_steps(FACTORS)
    rng = np.random.default_rng(1)
    model = fit(steps, [TRUTH(row) * rng.uniform(0.8, 1.8) for row in steps], above=TRUTH)
    assert model.fixed >= TRUTH.fixed
    for name in ("level", "step", "finest"):
        assert (np.array(getattr(model, name)) >= getattr(TRUTH, name)).all()
