"""Latency table: the cost model of a device, fitted to the times of a latency file."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from hyjax.core.schedule import Schedule
from hyjax.tuning.cost_model import CostModel, Milliseconds, fit, leave_one_out
from hyjax.tuning.device_latency import DeviceLatency, DeviceWorkload
from hyjax.tuning.factors import factors_for
from hyjax.util.errors import InputError


@dataclasses.dataclass
class LatencyTable:
    """Latencies of one workload on one device, in milliseconds.

    Attributes:
        workload: the shapes.
        factors: factors that a schedule may use, coarse to fine.
        median: model of the median time.
        p95: model of the 95th percentile, nowhere below `median`.
        error: `median_relative` and `worst_relative` of the median model on the schedules that were timed, each
            predicted from all the others. The worst is a level on its own, of whose cost no other schedule tells.
        timed: whole schedules, by `schedule_key`.
        stages: other stages of a frame, by name.
    """

    workload: DeviceWorkload
    factors: tuple[int, ...]
    median: CostModel
    p95: CostModel
    error: dict[str, float]
    timed: dict[str, Milliseconds]
    stages: dict[str, Milliseconds]

    @classmethod
    def of(cls, latency: DeviceLatency) -> "LatencyTable":
        """Table of the times of a device."""
        factors = factors_for(latency.workload.height, latency.workload.width)
        own = [
            timed
            for timed in latency.measured
            if has_searched_form(timed.schedule()) and {f for f, n in timed.steps.items() if n} <= set(factors)
        ]
        steps = [tuple(timed.steps.get(factor, 0) for factor in factors) for timed in own]
        _check_complete(steps, factors)
        medians = [timed.time.median for timed in own]
        median = fit(steps, medians)
        errors = leave_one_out(steps, medians)
        return cls(
            workload=latency.workload,
            factors=factors,
            median=median,
            p95=fit(steps, [timed.time.p95 for timed in own], above=median),
            error={"median_relative": float(np.median(errors)), "worst_relative": float(errors.max())},
            timed={timed.key: timed.time for timed in latency.measured},
            stages={name: Milliseconds(stage.median, stage.p95) for name, stage in latency.stages.items()},
        )

    def predict(self, steps: Sequence[int | float]) -> Milliseconds:
        """Predicted time of a schedule with these steps over the factors; a level with 0 steps is left out."""
        return Milliseconds(self.median(steps), self.p95(steps))

    def steps_of(self, schedule: Schedule) -> tuple[int, ...]:
        """A schedule's steps over the factors; levels without steps vanish."""
        counts = {level.factor: level.steps for level in schedule.levels if level.steps}
        for factor in counts.keys() - set(self.factors):
            raise InputError(
                f"schedule {schedule.name}: factor {factor} is not among the latency table's "
                f"{', '.join(map(str, self.factors))}"
            )
        return tuple(counts.get(factor, 0) for factor in self.factors)


def has_searched_form(schedule: Schedule) -> bool:
    """Whether a schedule has the form that the search gives all of its own."""
    with_data_term = all(level.fidelity is not None for level in schedule.levels)
    return schedule.upsampling == schedule.pooling == "guide" and schedule.norm == "l2" and with_data_term


def _check_complete(steps: Sequence[tuple[int, ...]], factors: Sequence[int]) -> None:
    hint = "hyjax tune --request lists the schedules to time"
    for place, factor in enumerate(factors):
        counts = {row[place] for row in steps} - {0}
        if len(counts) < 2:
            raise InputError(
                f"measured: factor {factor} is missing: schedules are needed that have two different numbers of "
                f"steps there, got {sorted(counts) or 'none'}; {hint}"
            )
    if len(steps) < (least := 2 * len(factors) + 1):
        raise InputError(
            f"measured: {len(steps)} schedules of the searched form; at least {least} are needed; {hint}"
        )
