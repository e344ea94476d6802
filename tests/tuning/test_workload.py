"""What is timed: shapes, long, and what decides a schedule's time."""

import dataclasses
from typing import Any

import pytest

from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning.workload import FACTORS, Workload, check_factors, factors_for, schedule_key
from hyjax.util.errors import InputError


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


@pytest.mark.parametrize("change", [{"height": 0}, {"lights": 1.5}, {"width": True}, {"dtype": "int8"}])
def test_bad_workloads_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"workload: .*{next(iter(change))}"):
        dataclasses.replace(Workload(512, 512, 2), **change)


def test_float64_needs_jax_to_have_it() -> None:
    with pytest.raises(InputError, match="JAX_ENABLE_X64"):
        Workload(8, 8, 1, dtype="float64")


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_arguments_are_the_same_every_time(dtype: str) -> None:
    workload = Workload(6, 5, 2, guide_channels=4, dtype=dtype)
    y, confidence, guide = workload.arguments()
    assert (y.shape, confidence.shape, guide.shape) == ((6, 5, 2), (6, 5, 1), (6, 5, 4))
    assert (y.dtype, confidence.dtype, guide.dtype) == (dtype, "float32", dtype)
    for first, second in zip((y, confidence, guide), workload.arguments()):
        assert (first == second).all()


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
