"""This machine as a device that times schedules, and its times in the cache folder."""

import hashlib
import logging
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from hyjax.core.schedule import Schedule
from hyjax.tuning import calibration
from hyjax.tuning.calibration import MOST_SECONDS, Arguments, probe_steps, schedule_of
from hyjax.tuning.cost_model import SHORTEST, Milliseconds
from hyjax.tuning.device_latency import (
    FORMAT,
    Device,
    DeviceLatency,
    DeviceWorkload,
    Stage,
    Timed,
    WarmUp,
    read_latency,
    write_latency,
)
from hyjax.tuning.device_request import LatencyRequest, calibration_schedules, latency_request
from hyjax.tuning.factors import factors_for, schedule_key
from hyjax.util import clock
from hyjax.util.cache import cache_folder
from hyjax.util.environment import cores, environment
from hyjax.util.errors import InputError
from hyjax.util.files import remove_stale

log = logging.getLogger(__name__)

REPEATS, CALIBRATION_REPEATS, PROBE_REPEATS = 100, 60, 40
PROBE = "probe"
"""Stage of a kept file: a paper-like schedule, timed on its own to check that the machine is still as fast."""
PROBE_TOLERANCE = 1.3
"""Kept times are believed while the probe takes between 1/1.3 and 1.3 times as long as it did then."""


class ThisMachine:
    """This machine: schedules are compiled, and timed in turns on the arrays of a frame."""

    def __init__(self, arguments: Arguments, progress: bool = True) -> None:
        self.arguments, self.progress = arguments, progress

    def identity(self) -> Device:
        """All that decides how fast compiled code is."""
        record = environment()
        versions = ", ".join(f"{name} {record['versions'][name]}" for name in ("hyjax", "jax", "jaxlib"))
        flags = os.environ.get("XLA_FLAGS", "")
        adapter = f"{cores()} cores, {self.arguments[0].dtype}, {hashlib.sha256(flags.encode()).hexdigest()[:8]}"
        return Device(name=record["device"], adapter=adapter, agent=versions)

    def latency(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> DeviceLatency:
        """Times of schedules as a latency file has them, with the probe's."""
        measured = self._timed(schedules, CALIBRATION_REPEATS, MOST_SECONDS, self.progress)
        probe = self.probe(request.workload)
        return DeviceLatency(
            format=FORMAT,
            device=self.identity(),
            workload=request.workload,
            measured=tuple(measured),
            warm_up=WarmUp(seconds=0.0, runs=1),
            stages={PROBE: Stage(median=probe.median, p95=probe.p95)},
            created=clock.timestamp(),
        )

    def times(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> list[Milliseconds]:
        """Times of schedules, in turns; fewer rounds (at least ten) where they would take more than a minute."""
        return [timed.time for timed in self._timed(schedules, REPEATS, 2 * MOST_SECONDS)]

    def probe(self, workload: DeviceWorkload, repeats: int = PROBE_REPEATS) -> Milliseconds:
        """Time of the probe on its own."""
        factors = factors_for(workload.height, workload.width)
        (timed,) = self._timed([schedule_of(factors, probe_steps(factors))], repeats, None)
        return timed.time

    def _timed(
        self, schedules: Sequence[Schedule], repeats: int, most_seconds: float | None, progress: bool = False
    ) -> list[Timed]:
        calls = calibration.compile_all(schedules, self.arguments, progress=progress)
        named = dict(zip(map(schedule_key, schedules), calls, strict=True))
        found = clock.measure_each(named, repeats, most_seconds=most_seconds, progress=progress)
        return [
            Timed.of(
                schedule,
                median=max(entry["median_ms"], SHORTEST),
                p95=max(entry["p95_ms"], SHORTEST),
                samples=int(entry["count"]),
            )
            for schedule, entry in zip(schedules, (found[name] for name in named), strict=True)
        ]


def kept_latency(
    machine: ThisMachine, workload: DeviceWorkload, recalibrate: bool = False
) -> tuple[DeviceLatency, str]:
    """Times of this machine: from the cache if they still hold, else measured and kept.

    Returns:
        The times, and in a few words where they are from.
    """
    schedules = calibration_schedules(workload)
    request = latency_request(workload, schedules)
    path = _path(machine, request)
    found = "asked for" if recalibrate else _from_cache(path, machine, workload)
    if isinstance(found, DeviceLatency):
        return found, f"from the cache (calibrated {found.created})"
    latency = machine.latency(request, schedules)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(path.parent)
        write_latency(path, latency)
    except (OSError, InputError) as error:
        log.warning("latency table is not kept: %s", error)
    return latency, f"calibrated anew: {found}"


def _path(machine: ThisMachine, request: LatencyRequest) -> Path:
    keys = [asked.key for asked in request.schedules]
    content = msgspec.json.encode([FORMAT, machine.identity(), request.workload, keys])
    return cache_folder() / f"latency-{hashlib.sha256(content).hexdigest()[:16]}.json"


def _from_cache(path: Path, machine: ThisMachine, workload: DeviceWorkload) -> DeviceLatency | str:
    """Kept times, or the reason why they cannot be used."""
    if not path.exists():
        return "none in the cache for this device, size and these versions"
    try:
        latency = read_latency(path)
    except InputError as error:
        return f"{path.name} in the cache is broken ({str(error).removeprefix(str(path)).lstrip(': ')})"
    if latency.device != machine.identity() or latency.workload != workload or PROBE not in latency.stages:
        return f"{path.name} in the cache is of another device or size"
    before = latency.stages[PROBE].median
    for repeats in (1, 3):  # a burst of other work on the machine is no reason yet
        now = machine.probe(workload, repeats * PROBE_REPEATS).median
        if now <= PROBE_TOLERANCE * before and before <= PROBE_TOLERANCE * now:
            return latency
    return f"a schedule that took {before:.2f} ms then takes {now:.2f} ms now"
