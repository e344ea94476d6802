"""The latency table: its calibration on a fake machine, the file, the cache; one small calibration for real."""

import copy
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
from hyjax.tuning import calibration, latency_table
from hyjax.tuning.calibration import calibration_steps, probe_steps
from hyjax.tuning.cost_model import Milliseconds
from hyjax.tuning.latency_table import (
    FACTORS,
    LatencyTable,
    Workload,
    load_table,
    new_table,
    save_table,
    schedule_key,
    time_schedules,
)
from hyjax.util import clock as latency
from hyjax.util.errors import InputError

WORKLOAD = Workload(1024, 1024, 2)


def truth(schedule: Schedule) -> float:
    counts = {level.factor: level.steps for level in schedule.levels}
    return TRUTH([counts.get(factor, 0) for factor in FACTORS])


@dataclasses.dataclass
class FakeMachine:
    """Stands in for compiler and clock: schedules take what TRUTH says times `slowness`, other calls 1 ms."""

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
        result = {}
        for name, call in calls.items():
            thing = call()
            time = truth(thing) * slowness if isinstance(thing, Schedule) else 1.0
            result[name] = {"first_ms": 9.0, "count": repeats, "median_ms": time, "p95_ms": 1.5 * time}
        return result


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeMachine:
    fake = FakeMachine()
    monkeypatch.setattr(calibration, "compile_all", fake.compile)
    monkeypatch.setattr(latency, "measure_each", fake.measure)
    monkeypatch.setattr(calibration, "own_stages", lambda factors, arguments: {"conductance": int})
    monkeypatch.setattr(Workload, "arguments", lambda self: ())
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return fake


@pytest.fixture
def table(machine: FakeMachine) -> LatencyTable:
    return new_table(WORKLOAD, progress=False)


# ---- calibration on the fake machine ----


def test_calibrate_fits_both_quantiles(table: LatencyTable) -> None:
    for row in random_steps():
        predicted = table.predict(row)
        assert predicted.median == pytest.approx(TRUTH(row), rel=1e-3)
        assert predicted.p95 == pytest.approx(1.5 * TRUTH(row), rel=1e-3)
    assert table.stages == {"conductance": Milliseconds(1.0, 1.5)}
    assert table.probe.median == pytest.approx(TRUTH(probe_steps(FACTORS)))
    assert 0 <= table.error["median_relative"] <= table.error["worst_relative"] < 0.3
    assert table.timed == {}


def test_the_tables_error_is_that_of_its_predictions(machine: FakeMachine, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a machine whose times are no sum of levels and steps: what the table says of itself holds for others."""
    additive = truth

    def rough(schedule: Schedule) -> float:
        total = sum(level.steps for level in schedule.levels)
        return additive(schedule) * (1.0 + 0.06 * np.sin(7.0 * total + 3.0 * len(schedule.levels)))

    monkeypatch.setattr(sys.modules[__name__], "truth", rough)
    table = new_table(WORKLOAD, progress=False)
    rows = random_steps()
    times = [rough(calibration.schedule_of(table.factors, row)) for row in rows]
    errors = [abs(table.predict(row).median / time - 1.0) for row, time in zip(rows, times)]
    assert 0.01 < np.median(errors) < 0.06 and max(errors) < 0.2
    assert np.median(errors) < table.error["median_relative"] < 3.0 * np.median(errors), "not flattered"


def test_all_calibration_schedules_are_timed_in_the_same_rounds(machine: FakeMachine, table: LatencyTable) -> None:
    assert len(machine.rounds[0]) == len(calibration_steps(FACTORS)) == len(table.calibration)


@pytest.mark.parametrize("factors", [(), (2, 4), (4, 4), (6, 4), (4, 0), (4.0, 2.0), (2, True)])
def test_bad_ladders_are_refused(factors: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="factors: "):
        new_table(WORKLOAD, factors=factors, progress=False)


# ---- schedules and stages timed for real ----


def test_steps_of_a_schedule(table: LatencyTable) -> None:
    assert table.steps_of(Schedule.preset("paper-50")) == (0, 5, 10, 15, 20, 0)
    assert table.steps_of(Schedule.uniform([(8, 3), (2, 0)])) == (0, 0, 3, 0, 0, 0)
    with pytest.raises(InputError, match=r"custom: factor 6 .* 32, 16"):
        table.steps_of(Schedule.uniform([(6, 3), (2, 1)]))


def test_timed_schedules_are_remembered(machine: FakeMachine, table: LatencyTable) -> None:
    first, second = Schedule.preset("paper-50"), Schedule.preset("paper-80")
    before = len(machine.compiled)
    times = time_schedules(table, [first, second, Schedule.preset("paper-50", kappa=0.5)], progress=False)
    assert len(machine.compiled) == before + 2  # κ does not matter
    assert times[0] == times[2] == Milliseconds(truth(first), 1.5 * truth(first))
    assert machine.rounds[-1] == list(table.timed) == ["16:5 8:10 4:15 2:20", "16:10 8:15 4:25 2:30"]

    machine.slowness = 3.0
    third = Schedule.uniform([(2, 4)])
    again = time_schedules(table, [third, first], progress=False)
    assert again[1] == times[0] and again[0].median == pytest.approx(3 * truth(third))
    assert machine.rounds[-1] == ["2:4"]
    assert time_schedules(table, [first], again=True, progress=False)[0].median == pytest.approx(3 * truth(first))
    assert table.timed[schedule_key(first)].median == pytest.approx(3 * truth(first))
    assert time_schedules(table, [], progress=False) == []


def test_schedules_of_other_forms_are_timed_apart(machine: FakeMachine, table: LatencyTable) -> None:
    before, steps = len(machine.compiled), [(16, 5), (8, 10)]
    paper, guided, free = Schedule.uniform(steps), guided_schedule(steps), guided_schedule(steps, fidelity=None)
    held_more = guided_schedule(steps, fidelity=2.0)
    time_schedules(table, [paper, guided, free, held_more], progress=False)
    assert len(machine.compiled) == before + 3  # α does not matter, as long as there is one
    assert {schedule_key(paper), schedule_key(guided), schedule_key(free)} == set(table.timed)


def test_arguments_of_other_shapes_are_refused(table: LatencyTable) -> None:
    wrong = jnp.zeros((1024, 1024, 2)), jnp.zeros((1024, 1024, 1), bool), jnp.zeros((1024, 1000, 3))
    with pytest.raises(InputError, match="guide: shape"):
        time_schedules(table, [Schedule.preset("shadow")], arguments=wrong, progress=False)


def test_no_repeats_is_refused(table: LatencyTable) -> None:
    with pytest.raises(InputError, match="repeats"):
        time_schedules(table, [Schedule.preset("shadow")], repeats=0, progress=False)


# ---- the file and the cache ----


def test_json_gives_the_same_table_back(table: LatencyTable) -> None:
    time_schedules(table, [Schedule.preset("paper-50")], progress=False)
    again = LatencyTable.from_json(table.to_json())
    assert again == table
    assert again.predict([1, 2, 3, 4, 5, 6]) == table.predict([1, 2, 3, 4, 5, 6])


BREAKERS: dict[str, Callable[[dict[str, Any]], object]] = {
    "other format": lambda c: c.update(format=99),
    "of the paper's form": lambda c: c.update(format=3),
    "no format": lambda c: c.pop("format"),
    "missing part": lambda c: c.pop("median"),
    "missing cost": lambda c: c["median"].pop("step"),
    "too few costs": lambda c: c["p95"]["step"].pop(),
    "negative cost": lambda c: c["p95"].update(fixed=-1.0),
    "not a number": lambda c: c["median"].update(fixed="1.0"),
    "nan": lambda c: c["probe"].update(median=float("nan")),
    "huge": lambda c: c["probe"].update(median=10**400),
    "bad factors": lambda c: c.update(ladder=[1, 2]),
    "no factors": lambda c: c.update(ladder=3),
    "bad workload": lambda c: c["workload"].update(height=-1),
    "unknown workload": lambda c: c["workload"].update(depth=1),
    "bad stage": lambda c: c.update(stages={"a": 3.0}),
    "bad timed": lambda c: c.update(timed=[1]),
    "bad calibration": lambda c: c["calibration"][0].update(steps=[0, 0]),
    "bad versions": lambda c: c.update(versions="1.0"),
}


@pytest.mark.parametrize("what", BREAKERS)
def test_a_broken_table_is_one_line(what: str, table: LatencyTable) -> None:
    content = copy.deepcopy(json.loads(table.to_json()))
    BREAKERS[what](content)
    with pytest.raises(InputError, match="latency table: ") as caught:
        LatencyTable.from_json(json.dumps(content))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "\x00"])
def test_a_file_that_is_no_table_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="latency table: ") as caught:
        LatencyTable.from_json(text)
    assert "\n" not in str(caught.value)


def test_load_calibrates_once_and_keeps_what_is_saved(machine: FakeMachine) -> None:
    table, why = load_table(WORKLOAD, progress=False)
    assert why.startswith("calibrated anew: none in the cache")
    time_schedules(table, [Schedule.preset("paper-50")], progress=False)
    save_table(table)
    measured = len(machine.rounds)
    again, why = load_table(WORKLOAD, progress=False)
    assert why == f"from the cache (calibrated {table.created})"
    assert again == table and again.timed
    assert machine.rounds[measured:] == [["probe"]]


def test_load_calibrates_when_asked_and_forgets_what_was_timed(machine: FakeMachine) -> None:
    table, _ = load_table(WORKLOAD, progress=False)
    time_schedules(table, [Schedule.preset("paper-50")], progress=False)
    save_table(table)
    again, why = load_table(WORKLOAD, recalibrate=True, progress=False)
    assert why == "calibrated anew: asked for" and not again.timed
    assert not load_table(WORKLOAD, progress=False)[0].timed


@pytest.mark.parametrize("slowness", [0.7, 1.4])
def test_load_calibrates_when_the_machine_has_changed(machine: FakeMachine, slowness: float) -> None:
    table, _ = load_table(WORKLOAD, progress=False)
    time_schedules(table, [Schedule.preset("paper-50")], progress=False)
    save_table(table)
    machine.slowness = slowness
    again, why = load_table(WORKLOAD, progress=False)
    assert why.startswith(f"calibrated anew: a schedule that took {table.probe.median:.2f} ms then takes ")
    assert again.probe.median == pytest.approx(slowness * table.probe.median) and not again.timed


def test_one_slow_spell_is_not_believed(machine: FakeMachine) -> None:
    load_table(WORKLOAD, progress=False)
    machine.spells = [5.0, 1.2]
    _, why = load_table(WORKLOAD, progress=False)
    assert why.startswith("from the cache") and not machine.spells


CHANGES: dict[str, Callable[[pytest.MonkeyPatch], tuple[Workload, tuple[int, ...]]]] = {
    "lights": lambda patch: (dataclasses.replace(WORKLOAD, lights=3), FACTORS),
    "guide": lambda patch: (dataclasses.replace(WORKLOAD, guide_channels=64), FACTORS),
    "dtype": lambda patch: (dataclasses.replace(WORKLOAD, dtype="bfloat16"), FACTORS),
    "factors": lambda patch: (WORKLOAD, FACTORS[1:]),
    "cores": lambda patch: (patch.setattr(latency_table, "cores", lambda: 99), (WORKLOAD, FACTORS))[1],
    "flags": lambda patch: (patch.setenv("XLA_FLAGS", "--x"), (WORKLOAD, FACTORS))[1],
    "version": lambda patch: (
        patch.setattr(latency_table, "environment", other_version),
        (WORKLOAD, FACTORS),
    )[1],
    "file format": lambda patch: (patch.setattr(latency_table, "FORMAT", 99), (WORKLOAD, FACTORS))[1],
}


def other_version() -> dict[str, Any]:
    return {"versions": {"hyjax": "9", "jax": "9", "jaxlib": "9"}, "device": "cpu: cpu"}


@pytest.mark.parametrize("what", CHANGES)
def test_a_table_of_something_else_is_not_used(
    what: str, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_table(WORKLOAD, progress=False)
    workload, factors = CHANGES[what](monkeypatch)
    _, why = load_table(workload, factors=factors, progress=False)
    assert why.startswith("calibrated anew: none in the cache")


def stored() -> Path:
    (path,) = latency_table.cache_folder().glob("latency-*.json")
    return path


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b'{"format": 1}', b"[" * 100_000, b"9" * 5000])
def test_a_broken_file_is_calibrated_over(content: bytes, machine: FakeMachine) -> None:
    load_table(WORKLOAD, progress=False)
    stored().write_bytes(content)
    _, why = load_table(WORKLOAD, progress=False)
    assert why.startswith("calibrated anew: latency-") and "\n" not in why
    assert load_table(WORKLOAD, progress=False)[1].startswith("from the cache")


def test_a_file_under_a_wrong_name_is_not_believed(machine: FakeMachine) -> None:
    load_table(WORKLOAD, progress=False)
    content = json.loads(stored().read_text())
    content["device"]["cores"] = 1000
    stored().write_text(json.dumps(content))
    _, why = load_table(WORKLOAD, progress=False)
    assert why.endswith("is of another device")


def test_an_unwritable_cache_is_a_warning(
    machine: FakeMachine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        table, why = load_table(WORKLOAD, progress=False)
    assert why.startswith("calibrated anew") and table.calibration
    assert "latency table is not kept" in caplog.text


# ---- for real ----


@pytest.mark.slow
def test_a_small_calibration_for_real(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path))
    table = new_table(Workload(120, 100, 2), (8, 4, 2), repeats=3, progress=False)
    assert table.factors == (4, 2)
    assert len(table.calibration) == len(calibration_steps((4, 2)))
    assert set(table.stages) == {"conductance", "resampling"}
    assert all(np.isfinite(value) for value in table.error.values())
    predicted = table.predict([5, 5])
    assert 0 < predicted.median <= predicted.p95 < float("inf")
    assert LatencyTable.from_json(table.to_json()) == table
    schedules = [Schedule.uniform([(4, 3), (2, 3)]), guided_schedule([(1, 2)])]
    for time in time_schedules(table, schedules, repeats=2, progress=False):
        assert 0 < time.median <= time.p95
    y, known, guide = table.workload.arguments()
    host = np.asarray(y), np.asarray(known), np.asarray(guide)
    time_schedules(table, schedules[:1], arguments=host, again=True, repeats=1, progress=False)
