"""The latency table: the fit on synthetic times, the file, the cache; one small calibration for real."""

import copy
import dataclasses
import functools
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.errors import InputError
from hyjax.schedule import Schedule
from hyjax.tuning import latency, latency_table
from hyjax.tuning.latency_table import (
    LADDER,
    CostModel,
    LatencyTable,
    Workload,
    calibrate,
    calibration_steps,
    fit,
    ladder_for,
    leave_one_out,
    load_table,
    probe_steps,
    save_table,
    schedule_key,
    time_schedules,
    time_stages,
)
from hyjax.tuning.result import Milliseconds

# Roughly what 512x512 with two lights costs on two cores.
TRUTH = CostModel(
    fixed=1.2,
    level=(0.5, 0.3, 0.5, 0.5, 0.8, 1.0),
    step=(0.002, 0.003, 0.004, 0.016, 0.076, 0.34),
    finest=(3.5, 0.4, 0.3, 0.1, 0.2, 0.0),
)
WORKLOAD = Workload(512, 512, 2)


def truth(schedule: Schedule) -> float:
    counts = {level.factor: level.steps for level in schedule.levels}
    return TRUTH([counts.get(factor, 0) for factor in LADDER])


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
    monkeypatch.setattr(latency_table, "_compile_all", fake.compile)
    monkeypatch.setattr(latency, "measure_each", fake.measure)
    monkeypatch.setattr(latency_table, "_own_stages", lambda table, arguments: {"conductance": int})
    monkeypatch.setattr(Workload, "arguments", lambda self: ())
    monkeypatch.setenv("HYJAX_CACHE", str(tmp_path / "cache"))
    return fake


@pytest.fixture
def table(machine: FakeMachine) -> LatencyTable:
    return calibrate(WORKLOAD, progress=False)


def random_steps(count: int = 40) -> list[list[int]]:
    rng = np.random.default_rng(3)
    rows = (rng.integers(0, 2, len(LADDER)) * rng.integers(1, 40, len(LADDER)) for _ in range(2 * count))
    return [row.tolist() for row in rows if row.any()][:count]


# ---- the model and its fit ----


def test_the_cost_model_adds_up() -> None:
    assert TRUTH([0, 5, 0, 0, 20, 0]) == pytest.approx(1.2 + 0.3 + 0.8 + 5 * 0.003 + 20 * 0.076 + 0.2)
    assert TRUTH([0.5, 0, 0, 0, 0, 0]) == pytest.approx(1.2 + 0.5 + 0.001 + 3.5)


@pytest.mark.parametrize("steps", [[1, 2], [0] * 6, [1, 0, 0, 0, 0, -1], [1, 0, 0, 0, 0, float("nan")]])
def test_the_cost_model_refuses_what_is_no_schedule(steps: list[float]) -> None:
    with pytest.raises(InputError, match="steps: "):
        TRUTH(steps)


@pytest.mark.parametrize("ladder", [LADDER, (16, 8, 4, 2), (4, 2, 1), (2, 1), (8,)])
def test_calibration_schedules_are_valid_and_tell_all_costs_apart(ladder: tuple[int, ...]) -> None:
    steps = calibration_steps(ladder)
    assert len(set(steps)) == len(steps) and len(steps) <= 32
    assert probe_steps(ladder) in steps
    for row in steps:
        latency_table._schedule(ladder, row)  # checks it
    # Two costs cannot be told apart by any schedules: the last level's two constants, and a constant moved from
    # `fixed` to every possible finest level.
    design = np.stack([latency_table._row(row) for row in steps])
    assert np.linalg.matrix_rank(design) == design.shape[1] - 2


def test_the_fit_recovers_an_additive_model() -> None:
    steps = calibration_steps(LADDER)
    model = fit(steps, [TRUTH(row) for row in steps])
    for row in random_steps():
        assert model(row) == pytest.approx(TRUTH(row), rel=1e-4)
    assert model.step == pytest.approx(TRUTH.step, rel=1e-2)
    assert min(model.finest[:-1]) == 0.0 or model.level[-1] == 0.0  # what all pay is in `fixed`
    assert leave_one_out(steps, [TRUTH(row) for row in steps]).max() < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_the_fit_withstands_outliers_in_a_tenth_of_the_times(seed: int) -> None:
    """Among the schedules that share their coefficients with others; a level's only evidence is beyond help."""
    rng = np.random.default_rng(seed)
    steps = calibration_steps(LADDER)
    times = np.array([TRUTH(row) for row in steps]) * rng.normal(1.0, 0.01, len(steps))
    ladders = [i for i, row in enumerate(steps) if np.count_nonzero(row) > 2]
    times[rng.choice(ladders, len(steps) // 10, replace=False)] *= rng.uniform(1.5, 4.0, len(steps) // 10)
    model = fit(steps, times)
    errors = [abs(model(row) / TRUTH(row) - 1.0) for row in random_steps()]
    assert np.median(errors) < 0.05 and max(errors) < 0.2


def test_the_fit_never_goes_below_its_bound() -> None:
    steps = calibration_steps(LADDER)
    rng = np.random.default_rng(1)
    model = fit(steps, [TRUTH(row) * rng.uniform(0.8, 1.8) for row in steps], above=TRUTH)
    assert model.fixed >= TRUTH.fixed
    for name in ("level", "step", "finest"):
        assert (np.array(getattr(model, name)) >= getattr(TRUTH, name)).all()


# ---- calibration on the fake machine ----


def test_calibrate_fits_both_quantiles(table: LatencyTable) -> None:
    for row in random_steps():
        predicted = table.predict(row)
        assert predicted.median == pytest.approx(TRUTH(row), rel=1e-3)
        assert predicted.p95 == pytest.approx(1.5 * TRUTH(row), rel=1e-3)
    assert table.stages == {"conductance": Milliseconds(1.0, 1.5)}
    assert table.probe.median == pytest.approx(TRUTH(probe_steps(LADDER)))
    assert 0 <= table.error["median_relative"] <= table.error["worst_relative"] < 0.3
    assert table.timed == {}


def test_all_calibration_schedules_are_timed_in_the_same_rounds(machine: FakeMachine, table: LatencyTable) -> None:
    assert len(machine.rounds[0]) == len(calibration_steps(LADDER)) == len(table.calibration)


def test_ladders_keep_what_fits_the_size() -> None:
    assert ladder_for(512, 512) == LADDER
    assert ladder_for(64, 64) == (16, 8, 4, 2, 1)
    assert ladder_for(100, 20, (8, 4)) == (4,)
    assert ladder_for(1, 1) == (1,)
    with pytest.raises(InputError, match="too coarse for 8x8"):
        ladder_for(8, 8, ladder=(16, 8))


@pytest.mark.parametrize("ladder", [(), (2, 4), (4, 4), (6, 4), (4, 0), (4.0, 2.0), (2, True)])
def test_bad_ladders_are_refused(ladder: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="ladder: "):
        calibrate(WORKLOAD, ladder=ladder, progress=False)


@pytest.mark.parametrize("change", [{"height": 0}, {"lights": 1.5}, {"width": True}, {"dtype": "int8"}])
def test_bad_workloads_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"workload: .*{next(iter(change))}"):
        dataclasses.replace(WORKLOAD, **change)


def test_float64_needs_jax_to_have_it() -> None:
    with pytest.raises(InputError, match="JAX_ENABLE_X64"):
        Workload(8, 8, 1, dtype="float64")


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_arguments_are_the_same_every_time(dtype: str) -> None:
    workload = Workload(6, 5, 2, guide_channels=4, dtype=dtype)
    y, known, guide = workload.arguments()
    assert (y.shape, known.shape, guide.shape) == ((6, 5, 2), (6, 5, 1), (6, 5, 4))
    assert (y.dtype, known.dtype, guide.dtype) == (dtype, bool, dtype)
    for first, second in zip((y, known, guide), workload.arguments()):
        assert (first == second).all()


# ---- schedules and stages timed for real ----


def test_steps_of_a_schedule(table: LatencyTable) -> None:
    assert table.steps_of(Schedule.preset("paper-50")) == (0, 5, 10, 15, 20, 0)
    assert table.steps_of(Schedule.uniform([(8, 3), (2, 0)])) == (0, 0, 3, 0, 0, 0)
    with pytest.raises(InputError, match=r"custom: factor 6 .* 32, 16"):
        table.steps_of(Schedule.uniform([(6, 3), (2, 1)]))


def test_schedule_key_has_what_decides_the_time() -> None:
    schedule = Schedule.uniform([(16, 5), (8, 10)])
    assert schedule_key(schedule) == "16:5 8:10"
    assert schedule_key(Schedule.uniform([(16, 5), (8, 10)], kappa=0.3, lam=0.1, name="x")) == "16:5 8:10"
    other = dataclasses.replace(schedule, pooling="guide", norm="mean_abs")
    assert schedule_key(other) == "16:5 8:10 pooling=guide norm=mean_abs"


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


def test_arguments_of_other_shapes_are_refused(table: LatencyTable) -> None:
    wrong = jnp.zeros((512, 512, 2)), jnp.zeros((512, 512, 1), bool), jnp.zeros((512, 500, 3))
    with pytest.raises(InputError, match="guide: shape"):
        time_schedules(table, [Schedule.preset("shadow")], arguments=wrong, progress=False)


def test_no_repeats_is_refused(table: LatencyTable) -> None:
    with pytest.raises(InputError, match="repeats"):
        time_stages(table, {"a": int}, 0)


def test_stages_are_kept(table: LatencyTable) -> None:
    assert time_stages(table, {"guide": int}, 3) == {"guide": Milliseconds(1.0, 1.5)}
    assert list(table.stages) == ["conductance", "guide"]


# ---- the file and the cache ----


def test_json_gives_the_same_table_back(table: LatencyTable) -> None:
    time_schedules(table, [Schedule.preset("paper-50")], progress=False)
    again = LatencyTable.from_json(table.to_json())
    assert again == table
    assert again.predict([1, 2, 3, 4, 5, 6]) == table.predict([1, 2, 3, 4, 5, 6])


BREAKERS: dict[str, Callable[[dict[str, Any]], object]] = {
    "other format": lambda c: c.update(format=99),
    "no format": lambda c: c.pop("format"),
    "missing part": lambda c: c.pop("median"),
    "missing cost": lambda c: c["median"].pop("step"),
    "too few costs": lambda c: c["p95"]["step"].pop(),
    "negative cost": lambda c: c["p95"].update(fixed=-1.0),
    "not a number": lambda c: c["median"].update(fixed="1.0"),
    "nan": lambda c: c["probe"].update(median=float("nan")),
    "huge": lambda c: c["probe"].update(median=10**400),
    "bad ladder": lambda c: c.update(ladder=[1, 2]),
    "no ladder": lambda c: c.update(ladder=3),
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
    "lights": lambda patch: (dataclasses.replace(WORKLOAD, lights=3), LADDER),
    "guide": lambda patch: (dataclasses.replace(WORKLOAD, guide_channels=64), LADDER),
    "dtype": lambda patch: (dataclasses.replace(WORKLOAD, dtype="bfloat16"), LADDER),
    "ladder": lambda patch: (WORKLOAD, LADDER[1:]),
    "cores": lambda patch: (patch.setattr(latency_table, "_cores", lambda: 99), (WORKLOAD, LADDER))[1],
    "flags": lambda patch: (patch.setenv("XLA_FLAGS", "--x"), (WORKLOAD, LADDER))[1],
    "version": lambda patch: (
        patch.setattr(latency_table, "environment", other_version),
        (WORKLOAD, LADDER),
    )[1],
    "file format": lambda patch: (patch.setattr(latency_table, "FORMAT", 99), (WORKLOAD, LADDER))[1],
}


def other_version() -> dict[str, Any]:
    return {"versions": {"hyjax": "9", "jax": "9", "jaxlib": "9"}, "device": "cpu: cpu"}


@pytest.mark.parametrize("what", CHANGES)
def test_a_table_of_something_else_is_not_used(
    what: str, machine: FakeMachine, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_table(WORKLOAD, progress=False)
    workload, ladder = CHANGES[what](monkeypatch)
    _, why = load_table(workload, ladder=ladder, progress=False)
    assert why.startswith("calibrated anew: none in the cache")


def stored() -> Path:
    (path,) = latency_table.cache_folder().glob("latency-*.json")
    return path


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b'{"format": 1}'])
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
    table = calibrate(Workload(24, 20, 2), (8, 4, 2), repeats=3, progress=False)
    assert table.ladder == (4, 2)
    assert len(table.calibration) == len(calibration_steps((4, 2)))
    assert set(table.stages) == {"conductance", "resampling"}
    assert all(np.isfinite(value) for value in table.error.values())
    predicted = table.predict([5, 5])
    assert 0 < predicted.median <= predicted.p95 < float("inf")
    assert LatencyTable.from_json(table.to_json()) == table
    schedules = [Schedule.uniform([(4, 3), (2, 3)]), Schedule.uniform([(1, 2)], pooling="guide")]
    for time in time_schedules(table, schedules, repeats=2, progress=False):
        assert 0 < time.median <= time.p95
    y, known, guide = table.workload.arguments()
    host = np.asarray(y), np.asarray(known), np.asarray(guide)
    time_schedules(table, schedules[:1], arguments=host, again=True, repeats=1, progress=False)


def test_what_is_timed_is_the_pipelines_cascade() -> None:
    arguments = Workload(16, 12, 1).arguments()
    schedules = [Schedule.uniform([(4, 2), (2, 3)]), Schedule.uniform([(2, 1)])]
    calls = latency_table._compile_all(schedules, arguments, progress=False)
    for call, schedule in zip(calls, schedules):
        np.testing.assert_allclose(call(), latency_table.cascade_known(*arguments, schedule), rtol=1e-6)


def test_an_error_while_compiling_comes_out() -> None:
    arguments = Workload(16, 12, 1).arguments()
    broken = Schedule((Schedule.uniform([(4, 2)]).levels[0],) * 2)  # the same level twice
    with pytest.raises(InputError, match="coarse to fine"):
        latency_table._compile_all([broken, Schedule.uniform([(2, 1)])], arguments, progress=False)
