"""The clock of schedules on this machine: its calibration on a fake one, the kept file; once for real."""

import dataclasses
import functools
import json
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from reference.costs import TRUTH, random_steps

from hyjax.core.schedule import Schedule, guided_schedule
from hyjax.tuning import calibration, this_machine
from hyjax.tuning.calibration import probe_steps
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.device_latency import FORMAT, Device, DeviceLatency, DeviceWorkload, Timed, WarmUp
from hyjax.tuning.device_request import LatencyRequest, calibration_schedules
from hyjax.tuning.factors import FACTORS, schedule_key
from hyjax.tuning.latency_table import LatencyTable
from hyjax.tuning.schedule_clock import MOST_CALIBRATIONS, ConnectedTimes, ScheduleClock
from hyjax.tuning.this_machine import PROBE, ThisMachine, kept_latency
from hyjax.util import clock
from hyjax.util.errors import InputError

WORKLOAD = DeviceWorkload(height=1024, width=1024, lights=2)
HERE = ThisMachine((jnp.zeros(1),) * 3, progress=False)


def truth(schedule: Schedule) -> float:
    counts = {level.factor: level.steps for level in schedule.levels}
    return TRUTH([counts.get(factor, 0) for factor in FACTORS])


@dataclasses.dataclass
class FakeMachine:
    """Stands in for compiler and clock: schedules take what TRUTH says times `slowness`."""

    slowness: float = 1.0
    compiled: list[Schedule] = dataclasses.field(default_factory=list)
    rounds: list[list[str]] = dataclasses.field(default_factory=list)
    spells: list[float] = dataclasses.field(default_factory=list)  # slowness of the next measurements

    def compile(self, schedules: Sequence[Schedule], arguments: object, *, progress: bool) -> list[Callable]:
        self.compiled += schedules
        return [functools.partial(lambda s: s, schedule) for schedule in schedules]

    def measure(self, calls: Mapping[str, Callable[[], Any]], repeats: int, **_: object) -> dict[str, dict]:
        self.rounds.append(list(calls))
        slowness = self.spells.pop(0) if self.spells else self.slowness
        times = {name: float(truth(call()) * slowness) for name, call in calls.items()}
        return {name: {"count": repeats, "median_ms": t, "p95_ms": 1.5 * t} for name, t in times.items()}


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeMachine:
    fake = FakeMachine()
    monkeypatch.setattr(calibration, "compile_all", fake.compile)
    monkeypatch.setattr(clock, "measure_each", fake.measure)
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return fake


@pytest.fixture
def own(machine: FakeMachine) -> ScheduleClock:
    return ScheduleClock(*clock_of(), engine=HERE)


def clock_of() -> tuple[Any, DeviceWorkload, str]:
    latency, origin = kept_latency(HERE, WORKLOAD)
    return latency, WORKLOAD, origin


# ---- calibration on the fake machine ----


def test_both_quantiles_are_fitted(own: ScheduleClock) -> None:
    for row in random_steps():
        predicted = own.table.predict(row)
        assert predicted.median == pytest.approx(TRUTH(row), rel=1e-3)
        assert predicted.p95 == pytest.approx(1.5 * TRUTH(row), rel=1e-3)
    assert own.latency.stages[PROBE].median == pytest.approx(TRUTH(probe_steps(FACTORS)))
    assert 0 <= own.table.error["median_relative"] <= own.table.error["worst_relative"] < 0.3
    assert own.device == "" and own.source.startswith("calibrated anew")


def test_the_tables_error_is_that_of_its_predictions(machine: FakeMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine whose times are no sum of levels and steps: what the table says of itself holds for others."""
    additive = truth

    def rough(schedule: Schedule) -> float:
        total = sum(level.steps for level in schedule.levels)
        return additive(schedule) * (1.0 + 0.06 * np.sin(7.0 * total + 3.0 * len(schedule.levels)))

    monkeypatch.setattr(sys.modules[__name__], "truth", rough)
    table = LatencyTable.of(clock_of()[0])
    rows = random_steps()
    times = [rough(calibration.schedule_of(table.factors, row)) for row in rows]
    errors = [abs(table.predict(row).median / time - 1.0) for row, time in zip(rows, times)]
    assert 0.01 < np.median(errors) < 0.06 and max(errors) < 0.2
    assert np.median(errors) < table.error["median_relative"] < 3.0 * np.median(errors), "not flattered"


def test_all_calibration_schedules_are_timed_in_the_same_rounds(machine: FakeMachine, own: ScheduleClock) -> None:
    assert len(machine.rounds[0]) == len(calibration_schedules(WORKLOAD)) == len(own.latency.measured)


# ---- schedules timed for real ----


def test_steps_of_a_schedule(own: ScheduleClock) -> None:
    assert own.table.steps_of(Schedule.preset("paper-50")) == (0, 5, 10, 15, 20, 0)
    assert own.table.steps_of(Schedule.uniform([(8, 3), (2, 0)])) == (0, 0, 3, 0, 0, 0)
    with pytest.raises(InputError, match=r"custom: factor 6 .* 32, 16"):
        own.table.steps_of(Schedule.uniform([(6, 3), (2, 1)]))


def test_timed_schedules_are_remembered(machine: FakeMachine, own: ScheduleClock) -> None:
    first, second = (Schedule.uniform(steps) for steps in ([(8, 3)], [(16, 5), (8, 10)]))
    before = len(machine.compiled)
    times = own.measure([first, second, Schedule.uniform([(8, 3)], kappa=0.5)])
    assert len(machine.compiled) == before + 2  # κ does not matter
    assert times[0] == times[2] == Milliseconds(truth(first), 1.5 * truth(first))
    assert machine.rounds[-1] == ["8:3", "16:5 8:10"]

    machine.slowness = 3.0
    third = Schedule.uniform([(2, 4)])
    again = own.measure([third, first])
    assert again[1] == times[0] and again[0].median == pytest.approx(3 * truth(third))
    assert machine.rounds[-1] == ["2:4"]
    assert own.measure([first], again=True)[0].median == pytest.approx(3 * truth(first))
    assert own.table.timed[schedule_key(first)].median == pytest.approx(3 * truth(first))
    assert own.measure([]) == []


def test_schedules_of_other_forms_are_timed_apart(machine: FakeMachine, own: ScheduleClock) -> None:
    before, steps = len(machine.compiled), [(16, 5), (8, 10)]
    paper, guided, free = Schedule.uniform(steps), guided_schedule(steps), guided_schedule(steps, fidelity=None)
    own.measure([paper, guided, free, guided_schedule(steps, fidelity=2.0)])
    assert len(machine.compiled) == before + 3  # α does not matter, as long as there is one
    assert {schedule_key(paper), schedule_key(guided), schedule_key(free)} <= set(own.table.timed)


def test_a_budget_below_the_smallest_schedule_is_refused(own: ScheduleClock) -> None:
    own.check_reachable(1e3)
    with pytest.raises(InputError, match=r"budget 0\.001 ms: out of reach .* give at least --budget-ms"):
        own.check_reachable(1e-3)


# ---- the kept file ----


def test_times_are_taken_once_and_kept(machine: FakeMachine) -> None:
    latency, _, why = clock_of()
    assert why.startswith("calibrated anew: none in the cache")
    measured = len(machine.rounds)
    again, _, why = clock_of()
    assert why == f"from the cache (calibrated {latency.created})"
    assert again == latency
    (probe,) = machine.rounds[measured:]
    assert len(probe) == 1, "the probe alone"


def test_times_are_taken_anew_when_asked(machine: FakeMachine) -> None:
    clock_of()
    _, why = kept_latency(HERE, WORKLOAD, recalibrate=True)
    assert why == "calibrated anew: asked for"


@pytest.mark.parametrize("slowness", [0.7, 1.4])
def test_times_are_taken_anew_when_the_machine_has_changed(machine: FakeMachine, slowness: float) -> None:
    latency = clock_of()[0]
    machine.slowness, before = slowness, latency.stages[PROBE].median
    again, _, why = clock_of()
    assert why.startswith(f"calibrated anew: a schedule that took {before:.2f} ms then takes ")
    assert again.stages[PROBE].median == pytest.approx(slowness * before)


def test_one_slow_spell_is_not_believed(machine: FakeMachine) -> None:
    clock_of()
    machine.spells = [5.0, 1.2]
    assert clock_of()[2].startswith("from the cache") and not machine.spells


def other_version() -> dict[str, Any]:
    return {"versions": {"hyjax": "9", "jax": "9", "jaxlib": "9"}, "device": "cpu: cpu"}


CHANGES: dict[str, Callable[[pytest.MonkeyPatch], Any]] = {
    "lights": lambda patch: (HERE, DeviceWorkload(height=1024, width=1024, lights=3)),
    "guide": lambda patch: (HERE, DeviceWorkload(height=1024, width=1024, lights=2, features=64)),
    "dtype": lambda patch: (ThisMachine((jnp.zeros(1, "bfloat16"),) * 3, progress=False), WORKLOAD),
    "cores": lambda patch: patch.setattr(this_machine, "cores", lambda: 99),
    "flags": lambda patch: patch.setenv("XLA_FLAGS", "--x"),
    "version": lambda patch: patch.setattr(this_machine, "environment", other_version),
}


@pytest.mark.parametrize("what", CHANGES)
def test_times_of_something_else_are_not_used(
    what: str, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock_of()
    _, why = kept_latency(*(CHANGES[what](monkeypatch) or (HERE, WORKLOAD)))
    assert why.startswith("calibrated anew: none in the cache")


def stored() -> Path:
    (path,) = this_machine.cache_folder().glob("latency-*.json")
    return path


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b'{"format": 1}', b"[" * 100_000, b"9" * 5000])
def test_a_broken_file_is_calibrated_over(content: bytes, machine: FakeMachine) -> None:
    clock_of()
    stored().write_bytes(content)
    why = clock_of()[2]
    assert why.startswith("calibrated anew: latency-") and "\n" not in why
    assert clock_of()[2].startswith("from the cache")


def test_a_file_under_a_wrong_name_is_not_believed(machine: FakeMachine) -> None:
    clock_of()
    content = json.loads(stored().read_text())
    content["device"]["adapter"] = "1000 cores"
    stored().write_text(json.dumps(content))
    assert clock_of()[2].endswith("is of another device or size")


def test_an_unwritable_cache_is_a_warning(
    machine: FakeMachine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        latency, _, why = clock_of()
    assert why.startswith("calibrated anew") and latency.measured
    assert "latency table is not kept" in caplog.text


# ---- for real ----


@pytest.mark.slow
def test_a_small_calibration_for_real(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    for name in ("REPEATS", "CALIBRATION_REPEATS", "PROBE_REPEATS"):
        monkeypatch.setattr(this_machine, name, 10)
    rng = np.random.default_rng(0)
    y, guide = (jnp.asarray(rng.random((50, 60, count), np.float32)) for count in (2, 3))
    here, workload = (
        ThisMachine((y, jnp.ones((50, 60, 1)), guide), False),
        DeviceWorkload(height=50, width=60, lights=2),
    )
    latency, _ = kept_latency(here, workload)
    own = ScheduleClock(latency, workload, engine=here)
    assert own.table.factors == (2, 1)
    assert all(np.isfinite(value) for value in own.table.error.values())
    predicted = own.table.predict([5, 5])
    assert 0 < predicted.median <= predicted.p95 < float("inf")
    for time in own.measure([Schedule.uniform([(2, 3)]), guided_schedule([(1, 2)])], again=True):
        assert 0 < time.median <= time.p95


class BusyDevice:
    """Stands in for a connected page; in its first rounds, other work slows the schedules that come first."""

    def __init__(self, busy: int) -> None:
        self.busy, self.said = busy, list[str]()
        self.say = self.said.append

    def latency(self, request: LatencyRequest, schedules: Sequence[Schedule]) -> DeviceLatency:
        busy, self.busy = self.busy > 0, self.busy - 1
        steps = [sum(level.steps for level in schedule.levels) for schedule in schedules]
        times = [200.0 - 0.1 * count if busy else 10.0 + count for count in steps]
        times = [time / (10.0 if busy and count == max(steps) else 1.0) for time, count in zip(times, steps)]
        return DeviceLatency(
            format=FORMAT,
            device=Device(name="a phone"),
            workload=request.workload,
            measured=tuple(Timed.of(s, milliseconds=(t,) * 10) for s, t in zip(schedules, times)),
            warm_up=WarmUp(seconds=1.0, runs=1),
        )


@pytest.mark.parametrize("busy", [0, 2, 3])
def test_a_device_that_other_work_disturbs_is_timed_again(busy: int) -> None:
    device = BusyDevice(busy)
    measured = ConnectedTimes(device)._measured  # type: ignore[arg-type]
    if busy == MOST_CALIBRATIONS:
        with pytest.raises(InputError, match=r"a phone: .*times must rise with steps; end other work on it"):
            measured(WORKLOAD)
    else:
        assert measured(WORKLOAD).measured[0].time.median < 100.0
    assert len(device.said) == min(busy, MOST_CALIBRATIONS - 1)
    assert all("taken again" in line for line in device.said)
