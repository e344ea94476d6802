"""Latency estimator of another device: predicted from its latency file, measured while its page is open."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from hyjax.core.schedule import Schedule
from hyjax.tuning.calibration import probe_steps
from hyjax.tuning.cases import Case
from hyjax.tuning.cost_model import CalibrationTime, Milliseconds, fit, leave_one_out
from hyjax.tuning.device_latency import DeviceLatency, DeviceWorkload, read_latency, write_latency
from hyjax.tuning.device_measuring import ConnectedDevice
from hyjax.tuning.device_request import calibration_schedules, each_once, has_levels, latency_request
from hyjax.tuning.latency_estimator import ScheduleClock, has_searched_form, workload_of
from hyjax.tuning.latency_table import LatencyTable
from hyjax.tuning.workload import factors_for, schedule_key
from hyjax.util.errors import InputError

FRAME_STAGES = ("surface", "shading and visibility", "filling", "shadow pass", "composite")
"""Stages besides the diffusion that a file must have where a budget is for the whole frame; `guide` where a network
makes it."""
DEFAULT_SCHEDULE = "hyjax"
"""Preset that candidates are timed in turns with."""


def latency_table(latency: DeviceLatency) -> LatencyTable:
    """Latency table of a device: the cost model fitted to its times."""
    workload = latency.workload.plain()
    factors = factors_for(workload.height, workload.width)
    steps: list[tuple[int, ...]] = []
    medians: list[float] = []
    p95s: list[float] = []
    calibration: list[CalibrationTime] = []
    for timed in latency.measured:
        used = {factor for factor, count in timed.steps.items() if count}
        if not has_searched_form(timed.schedule()) or not used <= set(factors):
            continue
        row, time = tuple(timed.steps.get(factor, 0) for factor in factors), timed.time
        steps.append(row)
        medians.append(time.median)
        p95s.append(time.p95)
        calibration.append({"steps": list(row), "median_ms": time.median, "p95_ms": time.p95})
    _check_complete(steps, factors)
    median = fit(steps, medians)
    p95 = fit(steps, p95s, above=median)
    errors = leave_one_out(steps, medians)
    times = {timed.key: timed.time for timed in latency.measured}
    probe = probe_steps(factors)
    return LatencyTable(
        workload=workload,
        factors=factors,
        device=msgspec.structs.asdict(latency.device),
        versions={},
        created=latency.created,
        median=median,
        p95=p95,
        error={"median_relative": float(np.median(errors)), "worst_relative": float(errors.max())},
        probe=Milliseconds(median(probe), p95(probe)),
        calibration=calibration,
        stages={name: Milliseconds(stage.median, stage.p95) for name, stage in latency.stages.items()},
        timed=times,
    )


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


class DeviceEstimator(ScheduleClock):
    """Times of a frame's diffusion on another device, or of its whole frame.

    Args:
        latency: of the device.
        workload: the scene's.
        origin: where `latency` is from, for messages.
        connected: the device itself; without it times are predicted.
        whole_frame: whether the other stages of a frame count.
    """

    def __init__(
        self,
        latency: DeviceLatency,
        workload: DeviceWorkload,
        origin: str = "latency file",
        *,
        connected: ConnectedDevice | None = None,
        whole_frame: bool = False,
    ) -> None:
        if _shapes(latency.workload) != _shapes(workload):
            raise InputError(f"{origin}: workload {latency.workload}; the scene's is {workload}")
        self.latency, self.connected, self.whole_frame = latency, connected, whole_frame
        self.device = latency.device.name
        try:
            self.table = latency_table(latency)
            stages = self._stages() if whole_frame else []
        except InputError as error:
            raise InputError(f"{origin}: {error}") from None
        self.rest = Milliseconds(sum(time.median for time in stages), sum(time.p95 for time in stages))
        self.cost = dataclasses.replace(self.table.p95, fixed=self.table.p95.fixed + self.rest.p95)
        how = "timed on it" if connected else "predicted, not timed, but for the schedules of the file"
        rise = latency.drift()
        drift = "" if rise is None else f", last rounds {100 * rise:+.0f} % against the first"
        self.source = f"{origin} of {self.device} ({len(latency.measured)} schedules{drift}); {how}"

    def _stages(self) -> list[Milliseconds]:
        if missing := [name for name in FRAME_STAGES if name not in self.table.stages]:
            raise InputError(f"stages: {', '.join(missing)} missing, which a budget for the whole frame needs")
        return list(self.table.stages.values())

    def predict(self, schedule: Schedule) -> Milliseconds:
        known = self.table.timed.get(schedule_key(schedule))
        if known is None or has_searched_form(schedule):
            known = self.table.predict(self.table.steps_of(schedule))
        return Milliseconds(self.rest.median + known.median, self.rest.p95 + known.p95)

    def is_timed(self, schedule: Schedule) -> bool:
        """Whether the device has run it; of a whole frame only parts were timed."""
        return not self.whole_frame and schedule_key(schedule) in self.table.timed

    def measure(
        self, schedules: Sequence[Schedule], *, again: bool = False, progress: bool = True
    ) -> list[Milliseconds]:
        """Times by the connected device, in turns with the preset `hyjax`; else those of the file."""
        wanted = [s for s in each_once(schedules) if again or not self.is_timed(s)]
        if self.connected is not None and wanted:
            usual = Schedule.preset(DEFAULT_SCHEDULE)
            asked = each_once([*wanted, usual] if has_levels(usual, self.table.factors) else wanted)
            request = latency_request(self.latency.workload, asked)
            times = self.connected.times(request, asked)
            self.table.timed.update({schedule_key(s): time for s, time in zip(asked, times, strict=True)})
        return [self.table.timed[schedule_key(s)] if self.is_timed(s) else self.predict(s) for s in schedules]

    def parts(self) -> dict[str, float]:
        """Times of the parts, as of every estimator."""
        own = self.table.p95
        cheapest = min(level + finest for level, finest in zip(own.level, own.finest))
        parts = {"reading, weighting and upsampling the filter": own.fixed, "one level": cheapest}
        if self.whole_frame:
            parts |= {name: time.p95 for name, time in self.table.stages.items()}
        return dict(sorted(parts.items(), key=lambda item: -item[1]))


def _shapes(workload: DeviceWorkload) -> tuple[int, int, int, int]:
    """Shapes that decide the time: channels are stored by fours."""
    return workload.height, workload.width, -(-workload.lights // 4), -(-workload.features // 4)


@dataclasses.dataclass(frozen=True)
class FileTimes:
    """Factory of a run's estimator from a latency file.

    Attributes:
        path: of the file.
        whole_frame: see `DeviceEstimator`.
    """

    path: Path
    whole_frame: bool = False

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the times."""
        return read_latency(self.path).fingerprint

    def __call__(self, case: Case) -> DeviceEstimator:
        """Estimator for frames like this one."""
        workload = DeviceWorkload.of(workload_of(case))
        return DeviceEstimator(read_latency(self.path), workload, str(self.path), whole_frame=self.whole_frame)


@dataclasses.dataclass(frozen=True)
class ConnectedTimes:
    """Factory of a run's estimator from a device whose page is open.

    Attributes:
        device: the device.
        kept: file that its times are written to; None for none.
        resume: take them from there if they are there.
        fingerprint: in the place of that of the times, which are not known yet.
    """

    device: ConnectedDevice
    kept: Path | None = None
    resume: bool = False
    fingerprint: str = "measured by the run"

    def __call__(self, case: Case) -> DeviceEstimator:
        """Estimator for frames like this one."""
        workload = DeviceWorkload.of(workload_of(case))
        if self.kept is not None and self.resume and self.kept.exists():
            latency, origin = read_latency(self.kept), str(self.kept)
            if latency.device != (found := self.device.identity()):
                raise InputError(f"{self.kept}: times of {latency.device.name}, not of {found.name}, which is here")
        else:
            schedules = calibration_schedules(workload)
            latency, origin = self.device.latency(latency_request(workload, schedules), schedules), "times"
            if self.kept is not None:
                write_latency(self.kept, latency)
        return DeviceEstimator(latency, workload, origin, connected=self.device)
