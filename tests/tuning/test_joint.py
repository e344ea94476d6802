"""Guide and schedule tuned together, on one small frame whose guide at first says nothing of its border."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from test_relaxation import case_of

from hyjax import InputError, Schedule, step_cycle
from hyjax.core.schedule import GUIDED_KAPPA, Level, guided_schedule
from hyjax.guide.choose import RGB
from hyjax.guide.convolution import convolve
from hyjax.tuning.cases import Case, raw_filter, refined_filter, scores
from hyjax.tuning.joint import check_joint, tune_jointly
from hyjax.tuning.relaxation import FIDELITY_RANGE, LAM_RANGE, RelaxedSchedule, prepare, relaxed_loss, relaxed_of

SIZE = (16, 24)
FACTORS = (4, 1)


def two_halves() -> tuple[Case, jnp.ndarray]:
    """Bright on the left, dark on the right, the left half's surface missing beside the border; and a trunk of two
    channels of which one shows the border."""
    case = case_of(SIZE, holes=False)
    left = np.arange(SIZE[1]) < SIZE[1] // 2
    truth = np.where(left[None, :, None], 400.0, 20.0) * np.ones((*SIZE, 2))
    known = np.ones((*SIZE, 1), bool)
    known[:, SIZE[1] // 2 - 4 : SIZE[1] // 2] = False
    truth = jnp.asarray(truth, jnp.float32)
    rng = np.random.default_rng(0)
    trunk = np.stack([left * np.ones(SIZE), 0.3 * rng.random(SIZE)], axis=-1)
    whole = jnp.ones(SIZE, bool)
    shaded = dataclasses.replace(case.shaded, illuminance=truth * known, confidence=jnp.asarray(known, jnp.float32))
    target = raw_filter(dataclasses.replace(shaded, illuminance=truth))
    case = dataclasses.replace(case, shaded=shaded, target=target, valid=whole)
    return case, jnp.asarray(trunk, jnp.float32)


@pytest.mark.slow
def test_the_kernel_learns_where_the_border_is() -> None:
    case, trunk = two_halves()
    kernel = jnp.zeros((1, 1, 2, 1)).at[0, 0].set(GUIDED_KAPPA * jnp.array([[1.0], [2.5]]))
    start = RelaxedSchedule.of((6.0, 6.0))
    point, tuned, before, after = tune_jointly([case], [trunk], kernel, start, FACTORS, iterations=120)
    assert after < 0.85 * before
    ratio = [abs(float(k[0, 0, 0, 0] / k[0, 0, 1, 0])) for k in (kernel, tuned)]
    assert ratio[1] > 1.1 * ratio[0]  # the channel with the border counts for more
    np.testing.assert_array_equal(point.steps, start.steps)
    for name in ("log_kappa", "logit_lam", "log_fidelity"):
        assert np.all(getattr(point, name) != getattr(start, name)), name
    with_guide = dataclasses.replace(case, guide=convolve(trunk[None], tuned)[0])
    assert float(relaxed_loss(point, prepare(with_guide, FACTORS), FACTORS)) == pytest.approx(after, rel=1e-4)
    schedule = point.schedule(FACTORS)
    assert scores([with_guide], [refined_filter(with_guide, schedule)])["loss"] == pytest.approx(after, rel=1e-3)


def test_without_time_nothing_changes() -> None:
    case, trunk = two_halves()
    kernel = jnp.full((1, 1, 2, 1), 0.02)
    point, same, before, after = tune_jointly(
        [case], [trunk], kernel, RelaxedSchedule.of((0.0, 2.0)), FACTORS, expired=lambda: True
    )
    assert before == after
    np.testing.assert_allclose(same, kernel, rtol=1e-6)
    np.testing.assert_array_equal(point.steps, (0.0, 2.0))


def test_a_schedule_becomes_a_plan_and_back() -> None:
    schedule = guided_schedule([(4, 3), (1, 5)], kappa=0.07, lam=0.2, fidelity=0.3)
    point = relaxed_of(schedule, FACTORS)
    again = point.schedule(FACTORS)
    assert [(level.factor, level.steps) for level in again.levels] == [(4, 3), (1, 5)]
    assert (again.pooling, again.upsampling) == (schedule.pooling, schedule.upsampling)
    for level in again.levels:
        np.testing.assert_allclose(level.kappa, 0.07, rtol=1e-5)
        np.testing.assert_allclose(level.step_sizes, 0.2, rtol=1e-5)
        np.testing.assert_allclose(level.fidelity, 0.3, rtol=1e-5)


def test_a_schedule_without_data_term_becomes_a_plan_with_next_to_none() -> None:
    point = relaxed_of(Schedule.uniform([(4, 3), (1, 5)], kappa=0.07), FACTORS)
    np.testing.assert_allclose(point.fidelity, FIDELITY_RANGE[0], rtol=1e-5)
    np.testing.assert_allclose(relaxed_of(guided_schedule([(4, 3)], fidelity=0.0), FACTORS).fidelity[0], 1e-4, 1e-5)


def test_a_step_cycle_becomes_the_largest_steps() -> None:
    cycle = step_cycle(6, 3.4)
    assert np.mean(cycle) > 0.25
    point = relaxed_of(Schedule((Level(4, cycle, np.float32(0.07)),)), FACTORS)
    np.testing.assert_allclose(point.lam[0], LAM_RANGE[1], rtol=1e-5)


def test_only_a_learned_guide_has_a_layer_to_tune() -> None:
    with pytest.raises(InputError, match="joint: the rgb guide has no layer to tune; give --guide small or a file"):
        check_joint(RGB, None)
