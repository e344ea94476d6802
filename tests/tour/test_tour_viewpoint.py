"""Viewpoint: schedules with more or fewer steps."""

import numpy as np

from hyjax.core.schedule import Schedule
from hyjax.tour.viewpoint import scale_schedule, scale_step_count


def test_more_steps_of_a_cycle_are_whole_cycles() -> None:
    cycle, plain = np.array([0.1, 0.9, 0.3]), np.full(4, 0.2)
    assert scale_step_count(cycle, 1.5).size in (3, 6) and scale_step_count(cycle, 0.5).tolist() == cycle.tolist()
    assert scale_step_count(cycle, 0.0).size == 0
    assert [scale_step_count(plain, times).size for times in (0.0, 0.5, 1.0, 2.0)] == [0, 2, 4, 8]


def test_a_scaled_schedule_can_be_run() -> None:
    schedule = Schedule.preset("paper-50")
    scaled = scale_schedule(schedule, 2.0, 10.0)
    scaled.check(dtype=np.float32)
    for old, new in zip(schedule.levels, scaled.levels, strict=True):
        assert len(new.step_sizes) == 2 * len(old.step_sizes) and new.factor == old.factor
        np.testing.assert_allclose(new.kappa, 10.0 * np.asarray(old.kappa), rtol=1e-6)
