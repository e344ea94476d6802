"""The choice of calibration schedules, and what is compiled to be timed."""

import numpy as np
import pytest

from hyjax.errors import InputError
from hyjax.refine import cascade_known
from hyjax.schedule import Schedule
from hyjax.tuning.calibration import calibration_steps, compile_all, probe_steps, schedule_of
from hyjax.tuning.cost_model import row_of
from hyjax.tuning.workload import LADDER, Workload


@pytest.mark.parametrize("ladder", [LADDER, (16, 8, 4, 2), (4, 2, 1), (2, 1), (8,)])
def test_calibration_schedules_are_valid_and_tell_all_costs_apart(ladder: tuple[int, ...]) -> None:
    steps = calibration_steps(ladder)
    assert len(set(steps)) == len(steps) and len(steps) <= 32
    assert probe_steps(ladder) in steps
    for row in steps:
        schedule_of(ladder, row)  # checks it
    # Two costs cannot be told apart by any schedules: the last level's two constants, and a constant moved from
    # `fixed` to every possible finest level.
    design = np.stack([row_of(row) for row in steps])
    assert np.linalg.matrix_rank(design) == design.shape[1] - 2


def test_what_is_timed_is_the_pipelines_cascade() -> None:
    arguments = Workload(16, 12, 1).arguments()
    schedules = [Schedule.uniform([(4, 2), (2, 3)]), Schedule.uniform([(2, 1)])]
    calls = compile_all(schedules, arguments, progress=False)
    for call, schedule in zip(calls, schedules):
        np.testing.assert_allclose(call(), cascade_known(*arguments, schedule), rtol=1e-6)


def test_an_error_while_compiling_comes_out() -> None:
    arguments = Workload(16, 12, 1).arguments()
    broken = Schedule((Schedule.uniform([(4, 2)]).levels[0],) * 2)  # the same level twice
    with pytest.raises(InputError, match="coarse to fine"):
        compile_all([broken, Schedule.uniform([(2, 1)])], arguments, progress=False)
