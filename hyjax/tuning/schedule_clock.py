"""Clock of the diffusion alone: times of schedules on this machine, of a latency file, or of a connected page.

All three are times in the form of a latency file: a model of the costs is fitted to them, which predicts schedules.
Where an engine is within reach, it times those that matter.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning.cases import Case
from hyjax.tuning.clock import FrameTime
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.device_latency import DeviceLatency, DeviceWorkload, read_latency, write_latency
from hyjax.tuning.device_request import LatencyRequest, calibration_schedules, each_once, latency_request
from hyjax.tuning.factors import schedule_key
from hyjax.tuning.latency_table import LatencyTable, has_searched_form
from hyjax.tuning.this_machine import ThisMachine, kept_latency
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    from hyjax.tuning.device_measuring import ConnectedDevice

FRAME_STAGES = ("surface", "shading and visibility", "filling", "shadow pass", "composite")
"""Stages besides the diffusion that a file must have where a budget is for the whole frame; `guide` where a network
makes it."""
MOST_CALIBRATIONS = 3
"""Most attempts to time a connected device on which other work runs."""


class Engine(Protocol):
    """Device that is within reach."""

    def times(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> list[Milliseconds]:
        """Times of schedules, in turns."""
        ...


class ScheduleClock:
    """Times of a frame's diffusion on a device, or of its whole frame.

    Attributes:
        cost: of the 95th percentile, over the table's factors: what a search keeps below a budget.
        source: in a few words, where the times are from.
        device: name of the device, where it is not the one that searches; else empty.
        base: schedule that others are relative to.

    Args:
        whole_frame: whether the other stages of a frame count.
    """

    base: Schedule

    def __init__(
        self,
        latency: DeviceLatency,
        workload: DeviceWorkload,
        origin: str = "latency file",
        *,
        engine: Engine | None = None,
        whole_frame: bool = False,
    ) -> None:
        if _shapes(latency.workload) != _shapes(workload):
            raise InputError(f"{origin}: workload {latency.workload}; the scene's is {workload}")
        self.latency, self.engine, self.whole_frame = latency, engine, whole_frame
        try:
            self.table = LatencyTable.of(latency)
            stages = self._stages() if whole_frame else []
        except InputError as error:
            raise InputError(f"{origin}: {error}") from None
        self.rest = Milliseconds(sum(time.median for time in stages), sum(time.p95 for time in stages))
        self.cost = dataclasses.replace(self.table.p95, fixed=self.table.p95.fixed + self.rest.p95)
        self.device, self.source = "", origin
        if not isinstance(engine, ThisMachine):
            self.device = latency.device.name
            how = "timed on it" if engine else "predicted, not timed, but for the schedules of the file"
            rise = latency.drift()
            drift = "" if rise is None else f", last rounds {100 * rise:+.0f} % against the first"
            self.source = f"{origin} of {self.device} ({len(latency.measured)} schedules{drift}); {how}"

    def _stages(self) -> list[Milliseconds]:
        if missing := [name for name in FRAME_STAGES if name not in self.table.stages]:
            raise InputError(f"stages: {', '.join(missing)} missing, which a budget for the whole frame needs")
        return list(self.table.stages.values())

    def predict(self, schedule: Schedule) -> Milliseconds:
        """Time by the cost model for schedules of the searched form; for others the measured time, if any."""
        time = self.table.timed.get(schedule_key(schedule))
        if time is None or has_searched_form(schedule):
            time = self.table.predict(self.table.steps_of(schedule))
        return Milliseconds(self.rest.median + time.median, self.rest.p95 + time.p95)

    def is_timed(self, schedule: Schedule) -> bool:
        """Whether the device has run a schedule; of a whole frame only parts were timed."""
        return not self.whole_frame and schedule_key(schedule) in self.table.timed

    def measure(self, schedules: Sequence[Schedule], *, again: bool = False) -> list[Milliseconds]:
        """Times by the engine, in turns, else as `predict`; schedules with a time are timed again on request."""
        wanted = [s for s in each_once(schedules) if again or not self.is_timed(s)]
        if self.engine is not None and wanted:
            times = self.engine.times(latency_request(self.latency.workload, wanted), wanted)
            self.table.timed.update({schedule_key(s): time for s, time in zip(wanted, times, strict=True)})
        return [self.table.timed[schedule_key(s)] if self.is_timed(s) else self.predict(s) for s in schedules]

    def times(
        self, configurations: Sequence[Configuration], repeats: int, *, most_seconds: float | None = None
    ) -> list[FrameTime]:
        """Times of the configurations' cascades for the light, in turns with the base.

        How often each runs is the engine's own.
        """
        schedules = [configuration.schedule for configuration in configurations]
        *measured, base = self.measure([*schedules, self.base], again=True)
        return [
            FrameTime(time.median, time.p95, base.median, time.median / base.median, not self.is_timed(schedule))
            for time, schedule in zip(measured, schedules, strict=True)
        ]

    def check_reachable(self, milliseconds: float) -> None:
        """Raise `InputError` if even the smallest schedule, on the clock, takes longer than the budget."""
        singles = [guided_schedule([(f, 1)], name=f"1 step at 1/{f}") for f in self.table.factors]
        cheapest = sorted(singles, key=lambda schedule: self.predict(schedule).p95)[:2]
        fastest = min(time.p95 for time in self.measure(cheapest))
        if fastest > milliseconds:  # not to refuse for a bad moment
            fastest = min(time.p95 for time in self.measure(cheapest, again=True))
        if fastest > milliseconds:
            parts = ", ".join(f"{name} {time:.2f} ms" for name, time in self._parts().items())
            raise InputError(
                f"budget {milliseconds:.3g} ms: out of reach on this device; the smallest reachable time (p95) is "
                f"{fastest:.2f} ms ({parts}); give at least --budget-ms {fastest * 1.05:.3g}, or a smaller --size"
            )

    def _parts(self) -> dict[str, float]:
        """Milliseconds (95th percentile) of the stages that no schedule changes, dearest first."""
        p95 = self.table.p95
        cheapest = min(level + finest for level, finest in zip(p95.level, p95.finest))
        parts = {"reading, weighting and upsampling the filter": p95.fixed, "one level": cheapest}
        if self.whole_frame:
            parts |= {name: time.p95 for name, time in self.table.stages.items()}
        return dict(sorted(parts.items(), key=lambda item: -item[1]))


def _shapes(workload: DeviceWorkload) -> tuple[int, int, int, int]:
    """Shapes that decide the time: channels are stored by fours."""
    return workload.height, workload.width, -(-workload.lights // 4), -(-workload.features // 4)


def workload_of(case: Case) -> DeviceWorkload:
    """Shapes of a case."""
    height, width, lights = case.shaded.illuminance.shape
    return DeviceWorkload(height=height, width=width, lights=lights, features=case.guide.shape[-1])


class LatencySource(Protocol):
    """Factory of a run's clock."""

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the times; empty where they are this machine's."""
        ...

    def __call__(self, case: Case) -> ScheduleClock:
        """Clock for frames like this one."""
        ...


@dataclasses.dataclass(frozen=True)
class OwnTimes:
    """Factory of the clock of this machine.

    Attributes:
        recalibrate: whether to time the schedules of the model anew, instead of taking them from the cache.
    """

    recalibrate: bool = False
    progress: bool = True
    fingerprint: str = ""

    def __call__(self, case: Case) -> ScheduleClock:
        arguments, workload = (case.shaded.illuminance, case.shaded.confidence, case.guide), workload_of(case)
        machine = ThisMachine(arguments, self.progress)
        latency, origin = kept_latency(machine, workload, self.recalibrate)
        return ScheduleClock(latency, workload, origin, engine=machine)


@dataclasses.dataclass(frozen=True)
class FileTimes:
    """Factory of the clock of a latency file."""

    path: Path
    whole_frame: bool = False

    @property
    def fingerprint(self) -> str:
        return read_latency(self.path).fingerprint

    def __call__(self, case: Case) -> ScheduleClock:
        latency = read_latency(self.path)
        return ScheduleClock(latency, workload_of(case), str(self.path), whole_frame=self.whole_frame)


@dataclasses.dataclass(frozen=True)
class ConnectedTimes:
    """Factory of the clock of a device whose page is open.

    Attributes:
        kept: file that its times are written to; None for none.
        resume: take them from there if they are there.
        fingerprint: in the place of that of the times, which are not known yet.
    """

    device: "ConnectedDevice"
    kept: Path | None = None
    resume: bool = False
    fingerprint: str = "measured by the run"

    def __call__(self, case: Case) -> ScheduleClock:
        workload = workload_of(case)
        if self.kept is not None and self.resume and self.kept.exists():
            latency, origin = read_latency(self.kept), str(self.kept)
            if latency.device != (found := self.device.identity()):
                raise InputError(f"{self.kept}: times of {latency.device.name}, not of {found.name}, which is here")
        else:
            latency, origin = self._measured(workload), "times"
            if self.kept is not None:
                write_latency(self.kept, latency)
        return ScheduleClock(latency, workload, origin, engine=self.device)

    def _measured(self, workload: DeviceWorkload) -> DeviceLatency:
        """Times of the calibration, taken again where other work made them fall with more steps."""
        schedules = calibration_schedules(workload)
        request = latency_request(workload, schedules)
        for left in reversed(range(MOST_CALIBRATIONS)):
            latency = self.device.latency(request, schedules)
            try:
                latency.check()
                return latency
            except InputError as error:
                if not left:
                    raise InputError(f"times of {latency.device.name}: {error}; end other work on it") from None
                self.device.say(f"other work disturbs the device; its times are taken again ({error})")
        raise AssertionError
