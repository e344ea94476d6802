"""Tuning for a device from end to end: a real browser, with WebGPU on the processor, is the phone."""

import contextlib
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from common import without_gradients

from experiments.browser import SOFTWARE_GPU, browser
from hyjax import Schedule
from hyjax.data.builtin_room import load_room
from hyjax.device.server import FolderSite, Server
from hyjax.export.bench import write_bench
from hyjax.tuning import device_request
from hyjax.tuning.bench import open_bench
from hyjax.tuning.cascade import tune_bench
from hyjax.tuning.device_latency import DeviceWorkload, parse_latency, read_latency
from hyjax.tuning.device_measuring import ConnectedDevice
from hyjax.tuning.schedule_clock import ConnectedTimes
from hyjax.tuning.settings import FrameOptions, OtherDevice, TuneScene, TuneSettings

AMPLE = 2000.0


@pytest.fixture
def page(browser_wanted: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """An empty page of a browser with WebGPU, and jobs that take seconds."""
    without_gradients(monkeypatch)
    monkeypatch.setattr(device_request, "ROUNDS", 10)
    monkeypatch.setattr(device_request, "WARM_UP_SECONDS", 0.0)
    monkeypatch.setattr(device_request, "SAMPLE_MS", 1.0)
    with browser(SOFTWARE_GPU) as launched:  # asked for: one that is missing fails
        yield launched.new_page()


def watch(page: Any, thread: threading.Thread, seconds: float = 600.0) -> list[str]:
    """What the page says until a thread has ended."""
    said: list[str] = []
    for _ in range(int(seconds / 0.2)):
        page.wait_for_timeout(200)
        line = page.inner_text("#status")
        said += [line] if line not in said[-1:] else []
        assert not page.inner_text("#trouble"), page.inner_text("#trouble")
        if not thread.is_alive():
            return said
    raise AssertionError(f"it has not come to an end: {said}")


@pytest.mark.slow
def test_a_schedule_for_the_browser_keeps_its_budget(page: Any, tmp_path: Path) -> None:
    room = load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)
    scene = TuneScene(size="64x48")
    options: dict[str, Any] = {"frames": "0", "holdout": "3", "extra": False, "quiet": True}
    options["frame"] = FrameOptions(trials=4)
    settings = TuneSettings(scene, OtherDevice(device=True), budget_ms=(AMPLE,), **options, out=tmp_path / "ample")
    lines: list[str] = []
    found: dict[str, Any] = {}
    with contextlib.closing(ConnectedDevice("127.0.0.1", 0, lines.append)) as device:

        def work() -> None:
            bench = open_bench(settings, capture=room)
            kept = tmp_path / "latency.json"
            times = ConnectedTimes(device, kept)
            found["ample"] = tune_bench(bench, settings, latency=times)
            # Less than the full resolution takes; more than the levels below it.
            coarse = [timed.time.p95 for timed in read_latency(kept).measured if not timed.steps.get(1)]
            found["budget"] = 1.5 * max(coarse)
            tight = TuneSettings(scene, budget_ms=(found["budget"],), **options, out=tmp_path / "tight")
            again = ConnectedTimes(device, kept, resume=True)
            found["tight"] = tune_bench(bench, tight, latency=again)
            schedules = [found["ample"].schedule, found["tight"].schedule]
            request = device_request.latency_request(read_latency(kept).workload, schedules)
            found["again"] = device.times(request, schedules)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        page.goto(device.server.address)
        said = watch(page, thread)
    assert any(line.startswith("Round") for line in said)
    assert "again" in found, lines
    for name, budget in (("ample", AMPLE), ("tight", found["budget"])):
        tuned = found[name]
        (best,) = tuned.best
        assert not best.time.predicted and best.time.p95 <= budget
        assert "swiftshader" in tuned.record["device"] and "timed on it" in tuned.record["latency"]["table"]
        kept = Schedule.from_json((tmp_path / name / "schedule.json").read_text())
        assert kept.to_json() == tuned.schedule.to_json()
        assert "swiftshader" in (tmp_path / name / "report.html").read_text()
    ample, tight = found["again"]
    assert ample.median <= AMPLE and tight.median <= found["budget"]


@pytest.mark.slow
def test_a_page_on_any_host_saves_what_tune_reads(page: Any, tmp_path: Path) -> None:
    folder = write_bench(tmp_path, DeviceWorkload(height=48, width=64, lights=2))
    server = Server(FolderSite(folder))
    try:
        page.goto(server.address)
        page.get_by_label("Name of this device").fill("Test browser")
        page.get_by_role("button", name="Time the presets").click()
        page.get_by_role("button", name="Save latency.json").wait_for(timeout=120_000)
        assert "naive-50" in page.inner_text("#times")
        with page.expect_download() as download:
            page.get_by_role("button", name="Save latency.json").click()
        saved = parse_latency(Path(download.value.path()).read_bytes())
    finally:
        server.stop()
    assert saved.device.name == "Test browser" and saved.workload.width == 64
    assert len(saved.rounds) == 10 and [timed.name for timed in saved.measured] == ["naive-50"]
    assert json.loads((folder / "request.json").read_text())["schedules"]


def test_a_page_without_webgpu_says_so(page: Any, tmp_path: Path) -> None:
    server = Server(FolderSite(write_bench(tmp_path, DeviceWorkload(height=48, width=64, lights=2))))
    try:
        page.add_init_script("Object.defineProperty(Navigator.prototype, 'gpu', { value: undefined })")
        page.goto(server.address)
        page.get_by_text("This browser has no WebGPU").wait_for(timeout=20_000)
    finally:
        server.stop()
