"""Latency table of this device: a cost model, the times of schedules and stages, kept in a cache.

The model is `cost_model`'s, fitted to schedules timed whole by `calibration`.
"""

import dataclasses
import hashlib
import json
import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from hyjax.core.schedule import Schedule
from hyjax.tuning import calibration
from hyjax.tuning.cost_model import CalibrationTime, CostModel, Milliseconds, Time, checked_steps
from hyjax.tuning.workload import FACTORS, Arguments, Workload, check_factors, factors_for, schedule_key
from hyjax.util import clock as latency
from hyjax.util.cache import cache_folder
from hyjax.util.environment import cores, environment
from hyjax.util.errors import InputError
from hyjax.util.files import remove_stale, write_text
from hyjax.util.reading import parse_json, read_text

log = logging.getLogger(__name__)

# Counted up when the file changes, or what a schedule's steps cost.
FORMAT = 5
# A stored table is believed while a probe takes between 1/1.3 and 1.3 times as long as it did then.
PROBE_TOLERANCE = 1.3


@dataclasses.dataclass
class LatencyTable:
    """Latencies of one workload on one device, in milliseconds.

    Attributes:
        workload: the shapes.
        factors: factors that a schedule may use, coarse to fine.
        device: platform and kind, cores, compiler flags.
        versions: of what decides how fast the compiled code is.
        created: when it was calibrated, ISO 8601.
        median: model of the median time.
        p95: model of the 95th percentile, nowhere below `median`.
        error: `median_relative` and `worst_relative` of the median model on the calibration's schedules, each
            predicted from all the others. The worst is a level on its own, of whose cost no other schedule tells.
        probe: a paper-like schedule timed on its own, to recognise later whether the device still is as fast.
        calibration: the schedules timed: `steps`, `median_ms`, `p95_ms`.
        stages: fixed costs of other stages, by name.
        timed: whole schedules timed for real, by `schedule_key`, see `time_schedules`.
    """

    workload: Workload
    factors: tuple[int, ...]
    device: dict[str, Any]
    versions: dict[str, str]
    created: str
    median: CostModel
    p95: CostModel
    error: dict[str, Time]
    probe: Milliseconds
    calibration: list[CalibrationTime]
    stages: dict[str, Milliseconds] = dataclasses.field(default_factory=dict)
    timed: dict[str, Milliseconds] = dataclasses.field(default_factory=dict)

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

    def key(self) -> dict[str, Any]:
        """Conditions that must agree for the table to be used again, as JSON's types."""
        return _key(self.workload, self.factors, self.device, self.versions)

    def __post_init__(self) -> None:
        check_factors(self.factors)
        for model in (self.median, self.p95):
            if any(len(costs) != len(self.factors) for costs in (model.level, model.step, model.finest)):
                raise InputError("a cost for each factor is needed")
        for timed in self.calibration:
            checked_steps(timed["steps"], len(self.factors))

    def to_json(self) -> str:
        """The table as JSON text, for `from_json`."""
        content = {"format": FORMAT} | dataclasses.asdict(self)
        content["ladder"] = content.pop("factors")
        return json.dumps(content, indent=1)

    @classmethod
    def from_json(cls, text: str) -> "LatencyTable":
        """Table of the text that `to_json` writes.

        Raises:
            InputError: not JSON, of another format version, or something missing or not what it should be.
        """
        try:
            content = parse_json(text, "latency table", only_finite=True)
            found = content.pop("format", None) if isinstance(content, dict) else None
            if found != FORMAT:
                raise InputError(f"format {found!r}, need {FORMAT}")
            content["factors"] = content.pop("ladder", None)
            table = msgspec.convert(content, cls)
            if unknown := content["workload"].keys() - vars(table.workload).keys():
                raise InputError(f"workload: unknown key {min(unknown)!r}")
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:  # msgspec's, of the parts
            raise InputError(f"latency table: {str(error).removeprefix('latency table: ')}") from None
        return table


# ---- timing ----


def new_table(
    workload: Workload,
    factors: Sequence[int] = FACTORS,
    *,
    repeats: int = calibration.REPEATS,
    progress: bool = True,
) -> LatencyTable:
    """Calibrate: time some thirty schedules of these shapes and fit the model to them.

    Args:
        workload: the shapes.
        factors: factors, coarse to fine; those too coarse for the shapes are dropped.
        repeats: times each schedule runs, fewer if that would take more than half a minute.
        progress: show bars on stderr.
    """
    factors = factors_for(workload.height, workload.width, factors)
    found = calibration.calibrate(workload.arguments(), factors, repeats=repeats, progress=progress)
    device, versions = _device_and_versions()
    return LatencyTable(
        workload=workload,
        factors=factors,
        device=device,
        versions=versions,
        created=latency.timestamp(),
        median=found.median,
        p95=found.p95,
        error=found.error,
        probe=found.probe,
        calibration=found.schedules,
        stages=found.stages,
    )


def time_schedules(
    table: LatencyTable,
    schedules: Sequence[Schedule],
    *,
    arguments: Arguments | None = None,
    repeats: int = 100,
    again: bool = False,
    progress: bool = True,
) -> list[Milliseconds]:
    """Time the compiled `cascade_known` for each schedule, in turns, and remember the times in `table.timed`.

    Args:
        table: for its workload and its memory; `save_table` keeps what it learns.
        schedules: any; those that differ in λ, κ and α alone take the same time and are timed once.
        arguments: filter, confidence and guide to time on; the workload's if not given.
        repeats: times each schedule runs, fewer (at least ten) if that would take more than a minute.
        again: also time those that the table remembers.
        progress: show bars on stderr.
    """
    keys = [schedule_key(schedule.check()) for schedule in schedules]
    wanted = {key: schedule for key, schedule in zip(keys, schedules) if again or key not in table.timed}
    if wanted:
        arguments = table.workload.arguments() if arguments is None else table.workload.on_device(arguments)
        calls = calibration.compile_all(list(wanted.values()), arguments, progress=progress)
        named = dict(zip(wanted, calls))
        most = 2 * calibration.MOST_SECONDS
        table.timed.update(calibration.time_calls(named, repeats, most_seconds=most, progress=progress))
    return [table.timed[key] for key in keys]


# ---- the cache ----


def _device_and_versions() -> tuple[dict[str, Any], dict[str, str]]:
    record = environment()
    device = {"name": record["device"], "cores": cores(), "xla_flags": os.environ.get("XLA_FLAGS", "")}
    return device, {name: record["versions"][name] for name in ("hyjax", "jax", "jaxlib")}


def _key(
    workload: Workload, factors: Sequence[int], device: Mapping[str, Any], versions: Mapping[str, str]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "workload": dataclasses.asdict(workload),
        "ladder": list(factors),
        "device": dict(device),
        "versions": dict(versions),
    }


def _path(key: Mapping[str, Any]) -> Path:
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return cache_folder() / f"latency-{digest[:16]}.json"


def save_table(table: LatencyTable) -> None:
    """Keep a table for `load_table`. A cache that cannot be written to is a warning in the log, no more."""
    path = _path(table.key())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale(path.parent)
        write_text(path, table.to_json())
    except (OSError, InputError) as error:
        log.warning("latency table is not kept: %s", error)


def load_table(
    workload: Workload,
    factors: Sequence[int] = FACTORS,
    *,
    recalibrate: bool = False,
    progress: bool = True,
) -> tuple[LatencyTable, str]:
    """The latency table of a workload on this device: from the cache if it still holds, else calibrated and kept.

    Args:
        workload: the shapes.
        factors: factors, coarse to fine; those too coarse for the shapes are dropped.
        recalibrate: calibrate anew whatever the cache says.
        progress: show bars on stderr.

    Returns:
        The table, and in a few words where it is from.
    """
    factors = factors_for(workload.height, workload.width, factors)
    reason = "asked for"
    if not recalibrate:
        found = _from_cache(workload, factors)
        if isinstance(found, LatencyTable):
            return found, f"from the cache (calibrated {found.created})"
        reason = found
    table = new_table(workload, factors, progress=progress)
    save_table(table)
    return table, f"calibrated anew: {reason}"


def _from_cache(workload: Workload, factors: tuple[int, ...]) -> LatencyTable | str:
    """Stored table, or the reason why it cannot be used."""
    key = _key(workload, factors, *_device_and_versions())
    path = _path(key)
    if not path.exists():
        return "none in the cache for this device, size and these versions"
    try:
        table = LatencyTable.from_json(read_text(path))
    except InputError as error:
        return f"{path.name} in the cache is broken ({error})"
    if table.key() != key:
        changed = [name for name, value in table.key().items() if value != key[name]]
        return f"{path.name} in the cache is of another {', '.join(changed)}"
    schedule = calibration.schedule_of(factors, calibration.probe_steps(factors))
    (probe,) = calibration.compile_all([schedule], workload.arguments(), progress=False)
    for repeats in (1, 3):  # a burst of other work on the machine is no reason yet
        now = calibration.time_probe(probe, repeats * calibration.PROBE_REPEATS).median
        if now <= PROBE_TOLERANCE * table.probe.median and table.probe.median <= PROBE_TOLERANCE * now:
            return table
    return f"a schedule that took {table.probe.median:.2f} ms then takes {now:.2f} ms now"
