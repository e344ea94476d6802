"""The choice of calibration schedules, and what is compiled to be timed."""

import numpy as np
import pytest

from hyjax.core.cascade import cascade
from hyjax.core.refine import cascade_known
from hyjax.core.schedule import GUIDED_FIDELITY, Schedule, guided_schedule
from hyjax.tuning.calibration import calibration_steps, compile_all, own_stages, probe_steps, schedule_of
from hyjax.tuning.cost_model import row_of
from hyjax.tuning.latency_estimator import has_searched_form
from hyjax.tuning.relaxation import RelaxedSchedule
from hyjax.tuning.workload import FACTORS, Workload, schedule_key
from hyjax.util.errors import InputError


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


def test_parts_of_the_cascade_are_the_probes() -> None:
    factors, (y, known, guide) = (4, 2), Workload(16, 12, 1).arguments()
    stages = own_stages(factors, (y, known, guide))
    assert {edge.shape for edges in stages["conductance"]() for edge in edges} == {(3, 3), (4, 2), (7, 6), (8, 5)}
    without = guided_schedule([(4, 0)], fidelity=GUIDED_FIDELITY)
    np.testing.assert_allclose(stages["resampling"](), cascade(y, guide, without), rtol=1e-6)


def test_what_is_timed_is_the_pipelines_cascade() -> None:
    arguments = Workload(16, 12, 1).arguments()
    schedules = [schedule_of((4, 2), (2, 3)), Schedule.uniform([(4, 2), (2, 3)]), Schedule.uniform([(2, 1)])]
    calls = compile_all(schedules, arguments, progress=False)
    for call, schedule in zip(calls, schedules):
        np.testing.assert_allclose(call(), cascade_known(*arguments, schedule), rtol=1e-6)


def test_an_error_while_compiling_comes_out() -> None:
    arguments = Workload(16, 12, 1).arguments()
    broken = Schedule((Schedule.uniform([(4, 2)]).levels[0],) * 2)  # the same level twice
    with pytest.raises(InputError, match="coarse to fine"):
        compile_all([broken, Schedule.uniform([(2, 1)])], arguments, progress=False)
