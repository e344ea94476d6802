"""Clock of the diffusion alone: times of a schedule, predicted by a latency table and measured."""

import abc
from collections.abc import Sequence
from typing import Protocol

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning.cases import Case
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.latency_table import (
    CostModel,
    LatencyTable,
    Workload,
    load_table,
    save_table,
    schedule_key,
    time_schedules,
)
from hyjax.util.errors import InputError

REPEATS = 100


class ScheduleClock(abc.ABC):
    """Times of schedules.

    Attributes:
        table: where they are kept.
        cost: of the 95th percentile, over the table's factors: what a search keeps below a budget.
        source: in a few words, where the times are from.
        device: name of the device, where it is not the one that searches; else empty.
        base: schedule that others are relative to.
    """

    table: LatencyTable
    cost: CostModel
    source: str
    device: str = ""
    base: Schedule

    @abc.abstractmethod
    def predict(self, schedule: Schedule) -> Milliseconds:
        """Prediction by the latency table."""

    @abc.abstractmethod
    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        """Measurement on the clock, in turns, where the device is within reach, else as `predict`.

        What was timed on this table before is timed again only if asked for.
        """

    @abc.abstractmethod
    def parts(self) -> dict[str, float]:
        """Milliseconds (95th percentile) of the stages that no schedule changes, dearest first."""

    def is_timed(self, schedule: Schedule) -> bool:
        """Whether what `measure` says of a schedule is timed; predicted if not."""
        return True

    def times(
        self, configurations: Sequence[Configuration], repeats: int = REPEATS, *, most_seconds: float | None = None
    ) -> list[FrameTime]:
        """Times of the configurations' cascades for the light, in turns with the base.

        How often each runs is this clock's own.
        """
        schedules = [configuration.schedule for configuration in configurations]
        *own, base = self.measure([*schedules, self.base], again=True, progress=False)
        return [
            FrameTime(time.median, time.p95, base.median, time.median / base.median, not self.is_timed(schedule))
            for time, schedule in zip(own, schedules, strict=True)
        ]


def workload_of(case: Case) -> Workload:
    """The shapes of a case."""
    h, w, lights = case.shaded.illuminance.shape
    return Workload(h, w, lights, case.guide.shape[-1], str(case.shaded.illuminance.dtype))


def has_searched_form(schedule: Schedule) -> bool:
    """Whether a schedule has the form that the search gives all of its own."""
    with_data_term = all(level.fidelity is not None for level in schedule.levels)
    return schedule.upsampling == schedule.pooling == "guide" and schedule.norm == "l2" and with_data_term


class LatencySource(Protocol):
    """Source of the clock of a run, in the place of this machine's."""

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the times."""
        ...

    def __call__(self, case: Case) -> ScheduleClock:
        """Clock for frames like this one."""
        ...


class CascadeEstimator(ScheduleClock):
    """Times of the diffusion stage, `cascade_known`, on this machine.

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


def smallest_schedules(clock: ScheduleClock) -> list[Schedule]:
    """One step at each level of the table's factors alone, the fastest first, by the latency table."""
    singles = [guided_schedule([(factor, 1)], name=f"1 step at 1/{factor}") for factor in clock.table.factors]
    return sorted(singles, key=lambda schedule: clock.predict(schedule).p95)


def check_reachable(clock: ScheduleClock, milliseconds: float) -> None:
    """Raise `InputError` if even the smallest schedule, on the clock, takes longer than the budget."""
    cheapest = smallest_schedules(clock)[:2]
    fastest = min(time.p95 for time in clock.measure(cheapest, progress=False))
    if fastest > milliseconds:  # not to refuse for a bad moment that the table remembers
        fastest = min(time.p95 for time in clock.measure(cheapest, again=True, progress=False))
    if fastest > milliseconds:
        parts = ", ".join(f"{name} {time:.2f} ms" for name, time in clock.parts().items())
        raise InputError(
            f"budget {milliseconds:.3g} ms: out of reach on this device; the smallest reachable time (p95) is "
            f"{fastest:.2f} ms ({parts}); give at least --budget-ms {fastest * 1.05:.3g}, or a smaller --size"
        )
