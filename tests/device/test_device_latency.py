"""Latency files of devices: there and back, what is refused, and the costs that are found in them."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from common import without_gradients
from hypothesis import given
from hypothesis import strategies as st

from hyjax import InputError, Schedule
from hyjax import tune_schedule as tune
from hyjax.core.schedule import guided_schedule
from hyjax.data.builtin_room import load_room
from hyjax.tuning.cost_model import CostModel
from hyjax.tuning.device_latency import (
    FEWEST_SAMPLES,
    Device,
    DeviceLatency,
    DeviceWorkload,
    Stage,
    Timed,
    WarmUp,
    parse_latency,
    read_latency,
    write_latency,
)
from hyjax.tuning.device_request import calibration_schedules, latency_request, measure_program, request_text
from hyjax.tuning.factors import factors_for, schedule_key
from hyjax.tuning.latency_table import LatencyTable
from hyjax.tuning.report_text import summary
from hyjax.tuning.schedule_clock import FRAME_STAGES, ScheduleClock
from hyjax.tuning.settings import FrameOptions, OtherDevice, TuneScene, TuneSettings
from hyjax.tuning.tune import write_request

WORKLOAD = DeviceWorkload(height=256, width=320, lights=2)
FACTORS = factors_for(256, 320)
COST = CostModel(0.4, (0.1, 0.12, 0.2, 0.3), (0.01, 0.03, 0.1, 0.35), (0.5, 0.3, 0.2, 0.0))
PHONE = Device(name="Phone", adapter="adapter", agent="engine 1", timer="gpu")
SCHEDULES = calibration_schedules(WORKLOAD)


def milliseconds(schedule: Schedule) -> float:
    """What the synthetic device takes."""
    counts = {level.factor: level.steps for level in schedule.levels}
    return COST([counts.get(factor, 0) for factor in FACTORS])


def latency(**changes: Any) -> DeviceLatency:
    """Of the synthetic device: every sample is the cost, but for each twentieth, which takes twice as long."""
    factor = np.where(np.arange(20) % 20 == 19, 2.0, 1.0)
    measured = tuple(Timed.of(s, milliseconds=tuple((milliseconds(s) * factor).tolist())) for s in SCHEDULES)
    content: dict[str, Any] = {"format": 1, "device": PHONE, "workload": WORKLOAD, "measured": measured}
    content |= {"warm_up": WarmUp(seconds=3.0, runs=40), "rounds": tuple(map(float, range(20)))}
    return DeviceLatency(**content | changes)


def text_of(value: DeviceLatency, path: Path) -> dict[str, Any]:
    write_latency(path, value)
    return json.loads(path.read_text())


def test_there_and_back(tmp_path: Path) -> None:
    path = tmp_path / "latency.json"
    value = latency(stages={"guide": Stage(median=1.0, p95=2.0)}, created="2026-01-01")
    write_latency(path, value)
    assert read_latency(path) == value and read_latency(path).fingerprint == value.fingerprint


@given(
    samples=st.lists(st.floats(1e-3, 1e5), min_size=FEWEST_SAMPLES, max_size=30),
    name=st.text(min_size=1, max_size=40),
    lights=st.integers(1, 32),
)
def test_any_times_come_back(samples: list[float], name: str, lights: int) -> None:
    measured = (Timed(steps={16: 2, 4: 0, 1: 3}, milliseconds=tuple(samples)),)
    workload = DeviceWorkload(height=64, width=48, lights=lights, precision="f16")
    before = latency(measured=measured, rounds=(), workload=workload, device=Device(name=name))
    after = parse_latency(msgspec.json.encode(before))
    assert after == before
    time = after.measured[0].time
    assert min(samples) <= time.median <= time.p95 <= max(samples)


def changed(content: dict[str, Any], path: str, value: Any) -> str:
    """JSON with one entry changed, or taken out where the value is `...`."""
    *parents, last = [int(key) if key.isdecimal() else key for key in path.split(".")]
    place: Any = content
    for key in parents:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return json.dumps(content)


@pytest.mark.parametrize(
    "path, value, words",
    [
        ("format", 2, ["format 2", "reads format 1"]),
        ("format", ..., ["format None"]),
        ("measured.0.milliseconds.3", -1.0, [">= 0.001", "measured[0].milliseconds[3]"]),
        ("measured.0.milliseconds.3", 1e-4, [">= 0.001", "measured[0].milliseconds[3]"]),
        ("measured.0.milliseconds.3", float("nan"), ["not JSON", "NaN"]),
        ("measured.0.milliseconds.3", "fast", ["float", "measured[0].milliseconds[3]"]),
        ("measured.0.milliseconds", [1.0] * 4, ["measured[0]", "4 samples are too few", "10"]),
        ("measured.0.milliseconds", [1.0] * 11, ["measured[0]", "11 samples in 20 rounds"]),
        ("measured.0.milliseconds", ..., ["measured[0]", "needs milliseconds"]),
        ("measured.0.median", 3.0, ["measured[0]", "either"]),
        ("measured.1.steps", {"16": -2}, [">= 0", "measured[1].steps"]),
        ("measured.1.steps", {"16": 3, "6": 2}, ["measured[1]", "multiple"]),
        ("measured.1.steps", {}, ["measured[1]", "at least one level"]),
        ("measured.1.sample", 3, ["sample", "measured[1]"]),
        ("measured", [], ["measured", "length"]),
        ("device.name", "", ["device.name", "length"]),
        ("workload.lights", 0, [">= 1", "workload.lights"]),
        ("workload.precision", "f8", ["f8", "workload.precision"]),
        ("rounds.2", 50.0, ["rounds", "rise"]),
        ("stages", {"guide": {"median": 2.0, "p95": 1.0}}, ["stages.guide", "below"]),
        ("warm_up", ..., ["warm_up"]),
    ],
)
def test_bad_files_are_refused_in_one_line(path: str, value: Any, words: list[str], tmp_path: Path) -> None:
    content = text_of(latency(), tmp_path / "good.json")
    (tmp_path / "bad.json").write_text(changed(content, path, value))
    with pytest.raises(InputError) as refused:
        read_latency(tmp_path / "bad.json")
    line = str(refused.value)
    assert "\n" not in line and "bad.json" in line
    assert all(word in line for word in words), line


def test_times_that_fall_with_steps_are_refused() -> None:
    few, many = (Timed(steps={16: n, 4: 1}, milliseconds=(0.1 * n,) * 20) for n in (2, 24))
    latency(measured=(few, many)).check()
    twisted = Timed(steps={16: 24, 4: 1}, milliseconds=(0.1,) * 20)
    with pytest.raises(InputError, match=r"^measured\[1\]: 0\.1 ms, but measured\[0\] takes 0\.2 ms for fewer"):
        latency(measured=(few, twisted)).check()
    noisy = Timed(steps={16: 24, 4: 1}, milliseconds=(0.19,) * 20)
    latency(measured=(few, noisy)).check()


def test_twice_the_same_schedule_is_refused() -> None:
    twin = latency().measured[:1] * 2
    with pytest.raises(InputError, match=r"measured\[1\]: the schedule of measured\[0\] again"):
        latency(measured=twin).check()


@pytest.mark.parametrize("content", [b"", b"[", b"\xff\xfe", b"[]", b"3", b'"x"', b"null"])
def test_what_is_no_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.json"):
        read_latency(tmp_path / "bad.json")
    with pytest.raises(InputError, match="no such file"):
        read_latency(tmp_path / "missing.json")


def test_costs_are_recovered() -> None:
    estimator = ScheduleClock(latency(), WORKLOAD)
    for steps in ([(16, 3), (4, 6)], [(8, 4), (2, 9), (1, 2)], [(2, 1)], [(1, 20)]):
        schedule = guided_schedule([(factor, count) for factor, count in steps if factor in FACTORS])
        expected = milliseconds(schedule)
        assert estimator.predict(schedule).median == pytest.approx(expected, rel=0.02)
        # Without a device what it has not run is predicted.
        if not estimator.is_timed(schedule):
            assert estimator.measure([schedule], again=True) == [estimator.predict(schedule)]
    known = Schedule.preset("naive-50")
    assert estimator.is_timed(known)
    assert estimator.measure([known])[0].median == pytest.approx(milliseconds(known))
    assert "not timed" in estimator.source and estimator.device == "Phone"


def test_summaries_do_for_samples() -> None:
    whole = latency()
    brief = tuple(
        Timed(steps=timed.steps, median=timed.time.median, p95=timed.time.p95, samples=20)
        for timed in whole.measured
        if timed.pooling == timed.upsampling == "guide"
    )
    steps = (1, 2, 3, 4)
    expected = LatencyTable.of(whole).predict(steps)
    assert LatencyTable.of(latency(measured=brief, rounds=())).predict(steps).p95 == pytest.approx(expected.p95)


def test_what_a_search_needs_must_be_there() -> None:
    without = tuple(t for t in latency().measured if not t.steps.get(2))
    with pytest.raises(InputError, match="factor 2 is missing"):
        ScheduleClock(latency(measured=without), WORKLOAD, "phone.json")
    other = DeviceWorkload(height=240, width=320, lights=2)
    with pytest.raises(InputError, match=r"phone\.json: workload 320x256.*the scene's is 320x240"):
        ScheduleClock(latency(), other, "phone.json")
    ScheduleClock(latency(), DeviceWorkload(height=256, width=320, lights=4))  # as many groups of four
    with pytest.raises(InputError, match=r"stages: .*shadow pass.* missing"):
        ScheduleClock(latency(), WORKLOAD, whole_frame=True)


def test_a_whole_frame_counts_all_stages() -> None:
    stages = {name: Stage(median=1.0, p95=2.0) for name in (*FRAME_STAGES, "guide")}
    frame = ScheduleClock(latency(stages=stages), WORKLOAD, whole_frame=True)
    own = ScheduleClock(latency(), WORKLOAD)
    schedule = SCHEDULES[0]
    assert frame.predict(schedule).median == pytest.approx(own.predict(schedule).median + 6.0)
    assert frame.cost((1, 1, 1, 1)) == pytest.approx(own.cost((1, 1, 1, 1)) + 12.0)
    assert not frame.is_timed(schedule)


def test_heat_shows() -> None:
    slower = tuple(
        Timed.of(s, milliseconds=tuple((milliseconds(s) * np.linspace(1.0, 1.6, 20)).tolist())) for s in SCHEDULES
    )
    assert latency(measured=slower).drift() == pytest.approx(0.4, abs=0.1)
    assert "%" in ScheduleClock(latency(measured=slower), WORKLOAD).source


def test_a_request_says_all_that_is_to_be_timed() -> None:
    request = latency_request(WORKLOAD, SCHEDULES)
    content = json.loads(request_text(request))
    assert content["rounds"] >= FEWEST_SAMPLES and content["workload"]["width"] == 320
    for entry, schedule in zip(content["schedules"], SCHEDULES, strict=True):
        assert Schedule.from_json(json.dumps(entry["whole"])).to_json() == schedule.to_json()
        assert entry["pooling"] == schedule.pooling
    program = measure_program(WORKLOAD, SCHEDULES)
    assert {launch.stage for launch in program.launches} == {str(k) for k in range(len(SCHEDULES))}
    keys = [schedule_key(schedule) for schedule in SCHEDULES]
    assert len(set(keys)) == len(keys)


def test_options_that_exclude_each_other(tmp_path: Path) -> None:
    path = tmp_path / "phone.json"
    write_latency(path, latency())
    for other, stage, words in (
        (OtherDevice(device=True, latency=path), "cascade", "not both"),
        (OtherDevice(device=True), "frame", "the diffusion alone"),
        (OtherDevice(device=True, port=-1), "cascade", "port"),
        (OtherDevice(latency=tmp_path / "missing.json"), "cascade", "no such file"),
    ):
        with pytest.raises(InputError, match=words):
            TuneSettings(target_device=other, stage=stage, fps=(60.0,)).check()
    record = TuneSettings(target_device=OtherDevice(latency=path), fps=(60.0,)).check().record()
    assert record["latency"] == str(path) and json.dumps(record)


@pytest.mark.slow
def test_a_schedule_for_a_device_that_is_not_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_gradients(monkeypatch)
    room = load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)
    scene = TuneScene(size="64x48")
    asked = tmp_path / "request.json"
    request = write_request(TuneSettings(scene, OtherDevice(request=asked), quiet=True), asked)
    written = json.loads(asked.read_text())["workload"]
    assert [written[name] for name in ("height", "width", "lights", "features")] == [48, 64, 2, 3]
    measured = []
    for entry in request.schedules:
        time = 0.5 + sum(0.2 + steps / factor**2 for factor, steps in entry.steps.items())
        form = {name: getattr(entry, name) for name in ("steps", "pooling", "upsampling", "norm", "fidelity")}
        measured.append(Timed(**form, milliseconds=(time,) * 12))
    value = latency(workload=request.workload, measured=tuple(measured), rounds=())
    path = tmp_path / "phone.json"
    write_latency(path, value)
    options: dict[str, Any] = {"frames": "0", "holdout": "3", "extra": False, "quiet": True}
    options |= {"frame": FrameOptions(trials=4), "out": tmp_path / "out"}
    settings = TuneSettings(scene, OtherDevice(latency=path), budget_ms=(3.0,), **options)
    tuned = tune(settings=settings, capture=room)
    (best,) = tuned.best
    assert best.time.predicted and best.time.p95 <= 3.0 and best.name.endswith(" on Phone")
    assert tuned.record["device"] == "Phone" and "searched on" in tuned.record
    assert "for Phone predicted, not timed" in summary(tuned)[0]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "p95, predicted" in page and "Phone" in page
    with pytest.raises(InputError, match=r"budget 0\.5 ms: out of reach"):
        tune(settings=dataclasses.replace(settings, out=None), budget_ms=0.5, capture=room)


def test_the_example_of_the_documentation_is_right() -> None:
    text = (Path(__file__).parents[2] / "docs" / "latency_format.md").read_text()
    _, example = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    content = json.loads(example)
    assert parse_latency(example).measured[1].time.p95 == 10.2
    for part in (DeviceLatency, Device, DeviceWorkload, Timed, WarmUp):
        assert all(f"{name}" in text for name in part.__struct_fields__), part
    assert set(content) == set(DeviceLatency.__struct_fields__)
