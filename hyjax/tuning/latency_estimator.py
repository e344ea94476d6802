"""Latency estimators: predicted and measured times of a schedule."""

from collections.abc import Sequence
from typing import Protocol

from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning.cases import Case
from hyjax.tuning.latency_table import (
    CostModel,
    LatencyTable,
    Workload,
    load_table,
    save_table,
    schedule_key,
    time_schedules,
)
from hyjax.tuning.result import Milliseconds
from hyjax.util.errors import InputError

REPEATS = 100
STAGE_REPEATS = 20


class LatencyEstimator(Protocol):
    """Times of whatever a budget is for, by schedule."""

    table: LatencyTable
    """Where its times are kept."""

    cost: CostModel
    """Of the 95th percentile, over the table's factors: what the search keeps below the budget."""

    source: str
    """In a few words, where the times are from."""

    device: str
    """Name of the device, where it is not the one that searches; else empty."""

    def predict(self, schedule: Schedule) -> Milliseconds:
        """By the latency table."""
        ...

    def is_timed(self, schedule: Schedule) -> bool:
        """Whether what `measure` has said of a schedule was timed; predicted if not."""
        ...

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        """On the clock, in turns, where the device is within reach, else as `predict`.

        What was timed on this table before is timed again only if asked for.
        """
        ...

    def parts(self) -> dict[str, float]:
        """Milliseconds (95th percentile) of what no schedule can change, dearest first."""
        ...


def workload_of(case: Case) -> Workload:
    """The shapes of a case."""
    h, w, lights = case.shaded.illuminance.shape
    return Workload(h, w, lights, case.guide.shape[-1], str(case.shaded.illuminance.dtype))


def has_searched_form(schedule: Schedule) -> bool:
    """Whether a schedule has the form that the search gives all of its own."""
    with_data_term = all(level.fidelity is not None for level in schedule.levels)
    return schedule.upsampling == schedule.pooling == "guide" and schedule.norm == "l2" and with_data_term


class LatencySource(Protocol):
    """What makes the estimator of a run, in the place of this machine's."""

    @property
    def fingerprint(self) -> str:
        """Of the times."""
        ...

    def __call__(self, case: Case) -> LatencyEstimator:
        """Estimator for frames like this one."""
        ...


class OwnEstimator:
    """Base of this machine's estimators."""

    device = ""

    def is_timed(self, schedule: Schedule) -> bool:
        """Always: this machine is there."""
        return True


class CascadeEstimator(OwnEstimator):
    """Times of the diffusion stage, `cascade_known`.

    Args:
        case: the arrays to time on.
        recalibrate: whether to make the latency table anew.
        progress: show bars on stderr.
    """

    def __init__(self, case: Case, *, recalibrate: bool = False, progress: bool = True) -> None:
        self.table, self.source = load_table(workload_of(case), recalibrate=recalibrate, progress=progress)
        self.arguments = case.cascade_arguments
        self.cost = self.table.p95

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(schedule_key(schedule))
        if known is not None and not has_searched_form(schedule):
            return known  # the table's model is of the form that is searched
        return self.table.predict(self.table.steps_of(schedule))

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        times = time_schedules(
            self.table, schedules, arguments=self.arguments, repeats=REPEATS, again=again, progress=progress
        )
        save_table(self.table)
        return times

    def parts(self) -> dict[str, float]:
        cheapest = min(level + finest for level, finest in zip(self.table.p95.level, self.table.p95.finest))
        return {"reading, weighting and upsampling the filter": self.table.p95.fixed, "one level": cheapest}


def smallest_schedules(estimator: LatencyEstimator) -> list[Schedule]:
    """One step at each level of the table's factors alone, the fastest first, by the latency table."""
    singles = [guided_schedule([(factor, 1)], name=f"1 step at 1/{factor}") for factor in estimator.table.factors]
    return sorted(singles, key=lambda schedule: estimator.predict(schedule).p95)


def check_reachable(estimator: LatencyEstimator, milliseconds: float) -> None:
    """Raise `InputError` if even the smallest schedule, on the clock, takes longer than the budget."""
    cheapest = smallest_schedules(estimator)[:2]
    fastest = min(time.p95 for time in estimator.measure(cheapest, progress=False))
    if fastest > milliseconds:  # not to refuse for a bad moment that the table remembers
        fastest = min(time.p95 for time in estimator.measure(cheapest, again=True, progress=False))
    if fastest > milliseconds:
        parts = ", ".join(f"{name} {time:.2f} ms" for name, time in estimator.parts().items())
        raise InputError(
            f"budget {milliseconds:.3g} ms: out of reach on this device; the smallest reachable time (p95) is "
            f"{fastest:.2f} ms ({parts}); give at least --budget-ms {fastest * 1.05:.3g}, or a smaller --size"
        )
