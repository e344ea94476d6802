"""The choice of calibration schedules, and what is compiled to be timed."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.core.refine import cascade_known
from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning.calibration import Arguments, calibration_steps, compile_all, probe_steps, schedule_of
from hyjax.tuning.cost_model import row_of
from hyjax.tuning.factors import FACTORS, check_factors, factors_for, schedule_key
from hyjax.tuning.latency_table import has_searched_form
from hyjax.tuning.relaxation import RelaxedSchedule
from hyjax.util.errors import InputError


def arguments_of(height: int, width: int, lights: int) -> Arguments:
    rng = np.random.default_rng(0)
    y, guide = (rng.random((height, width, count), np.float32) for count in (lights, 3))
    return jnp.asarray(y), jnp.asarray(rng.random((height, width, 1)) > 0.1, jnp.float32), jnp.asarray(guide)


@pytest.mark.parametrize("factors", [FACTORS, (16, 8, 4, 2), (4, 2, 1), (2, 1), (8,)])
def test_calibration_schedules_are_valid_and_tell_all_costs_apart(factors: tuple[int, ...]) -> None:
    steps = calibration_steps(factors)
    assert len(set(steps)) == len(steps) and len(steps) <= 32
    assert probe_steps(factors) in steps
    for row in steps:
        assert has_searched_form(schedule_of(factors, row))
    # Two costs cannot be told apart by any schedules: the last level's two constants, and a constant moved from
    # `fixed` to every possible finest level.
    design = np.stack([row_of(row) for row in steps])
    assert np.linalg.matrix_rank(design) == design.shape[1] - 2


def test_what_is_timed_takes_the_time_of_what_is_searched() -> None:
    for row in calibration_steps((8, 4, 1)):
        assert schedule_key(schedule_of((8, 4, 1), row)) == schedule_key(
            RelaxedSchedule.of(row).schedule((8, 4, 1))
        )
    assert has_searched_form(Schedule.preset("hyjax")) and not has_searched_form(Schedule.preset("paper-50"))
    for changes in ({"fidelity": None}, {"norm": "mean_abs"}, {"pooling": "edges"}, {"upsampling": "bilinear"}):
        assert not has_searched_form(guided_schedule([(4, 2)], **changes))


def test_what_is_timed_is_the_pipelines_cascade() -> None:
    arguments = arguments_of(16, 12, 1)
    schedules = [schedule_of((4, 2), (2, 3)), Schedule.uniform([(4, 2), (2, 3)]), Schedule.uniform([(2, 1)])]
    calls = compile_all(schedules, arguments, progress=False)
    for call, schedule in zip(calls, schedules):
        np.testing.assert_allclose(call(), cascade_known(*arguments, schedule), rtol=1e-6)


def test_an_error_while_compiling_comes_out() -> None:
    arguments = arguments_of(16, 12, 1)
    broken = Schedule((Schedule.uniform([(4, 2)]).levels[0],) * 2)  # the same level twice
    with pytest.raises(InputError, match="coarse to fine"):
        compile_all([broken, Schedule.uniform([(2, 1)])], arguments, progress=False)


def test_ladders_keep_what_fits_the_size() -> None:
    assert factors_for(1080, 1920) == FACTORS
    assert factors_for(512, 512) == (16, 8, 4, 2, 1)
    assert factors_for(64, 64) == (2, 1)
    assert factors_for(200, 100, (8, 4)) == (4,)
    assert factors_for(1, 1) == (1,)
    with pytest.raises(InputError, match="too coarse for 8x8"):
        factors_for(8, 8, factors=(16, 8))


@pytest.mark.parametrize("factors", [(), (2, 4), (4, 4), (6, 4), (4, 0), (4.0, 2.0), (2, True)])
def test_bad_ladders_are_refused(factors: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="factors: "):
        check_factors(factors)


def test_schedule_key_has_what_decides_the_time() -> None:
    schedule = Schedule.uniform([(16, 5), (8, 10)])
    assert schedule_key(schedule) == "16:5 8:10"
    assert schedule_key(Schedule.uniform([(16, 5), (8, 10)], kappa=0.3, lam=0.1, name="x")) == "16:5 8:10"
    other = dataclasses.replace(schedule, pooling="guide", norm="mean_abs")
    assert schedule_key(other) == "16:5 8:10 pooling=guide norm=mean_abs"
    guided = guided_schedule([(16, 5), (8, 10)])
    assert schedule_key(guided) == "16:5 8:10 pooling=guide upsampling=guide attached"
    assert schedule_key(guided_schedule([(16, 5), (8, 10)], fidelity=3.0, kappa=0.3)) == schedule_key(guided)
    free = guided_schedule([(16, 5), (8, 10)], fidelity=None)
    assert schedule_key(free) == "16:5 8:10 pooling=guide upsampling=guide"
