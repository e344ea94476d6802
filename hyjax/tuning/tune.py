"""The best configuration, or the best schedule, for a frame rate: `hyjax tune` as functions."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyjax.data.capture import Capture
from hyjax.guide.choose import open_guide
from hyjax.tuning.bench import open_bench, open_frame_bench
from hyjax.tuning.cascade import tune_bench
from hyjax.tuning.request import split_frames
from hyjax.tuning.result import Tuned
from hyjax.tuning.run import Run, opened
from hyjax.tuning.schedule_clock import ConnectedTimes, FileTimes, LatencySource, OwnTimes, workload_of
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.stage import FrameStage
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.files import write_text
from hyjax.util.terminal import write_above_bars

if TYPE_CHECKING:
    from hyjax.tuning.device_request import LatencyRequest


@checked_arguments
def tune(
    *,
    settings: TuneSettings | None = None,
    fps: float | Sequence[float] | None = None,
    budget_ms: float | Sequence[float] | None = None,
    capture: Capture | None = None,
) -> Tuned:
    """Find the configuration whose relit frames come closest to their targets within each time budget.

    Args:
        settings: what to tune for and on; a budget, in them or below, is all that is needed.
        fps: frame rates, one or several, in the place of the settings'.
        budget_ms: budgets in milliseconds, likewise.
        capture: frames that were opened before, in the place of those that the settings name.

    Returns:
        Configurations, measured, with the front of quality against time. Its `configuration` goes into
        `RelightSettings` as a file, or into `Relighter` as it is.

    Raises:
        InputError: any of these cannot be used, or a budget is out of reach on this device.
    """
    settings = _settings(settings, fps, budget_ms)
    if not settings.tunes_frame:
        raise InputError(
            "stage: `tune` is for the whole frame on this machine; for the rest there is `tune_schedule`"
        )
    settings.check()
    with opened(settings) as monitor:
        stage = FrameStage(open_frame_bench(settings, capture), settings)
        return Run(stage, settings, settings.budgets(), monitor).run()


@checked_arguments
def tune_schedule(
    *,
    settings: TuneSettings | None = None,
    fps: float | Sequence[float] | None = None,
    budget_ms: float | Sequence[float] | None = None,
    capture: Capture | None = None,
) -> Tuned:
    """Find the schedule of the diffusion alone whose filters come closest to the target's within each time budget.

    Times are this machine's, or those of the device that the settings name.

    Args:
        settings: what to tune for and on; a budget, in them or below, is all that is needed.
        fps: frame rates, one or several, in the place of the settings'.
        budget_ms: budgets in milliseconds, likewise.
        capture: frames that were opened before, in the place of those that the settings name.

    Returns:
        Schedules, measured, with all trials and the front of quality against time. Its `schedule` goes into
        `hyjax.relight` as it is.

    Raises:
        InputError: any of these cannot be used, or a budget is out of reach on this device.
    """
    settings = _settings(settings, fps, budget_ms)
    if settings.stage is None:
        settings = dataclasses.replace(settings, stage="cascade")
    if settings.tunes_frame:
        raise InputError("stage: a frame on this machine is tuned by `hyjax.tune`; give stage='cascade'")
    settings.check()
    guide = open_guide(settings.guide)
    with opened(settings) as monitor, _latency_source(settings) as latency:
        bench = open_bench(settings, capture=capture, guide=guide)
        return tune_bench(bench, settings, latency=latency, monitor=monitor)


@contextlib.contextmanager
def _latency_source(settings: TuneSettings) -> Iterator[LatencySource]:
    """Source of the times of the device to tune for."""
    other = settings.target_device
    if other.latency is None and not other.device:
        yield OwnTimes(settings.recalibrate, not settings.quiet)
        return
    if other.latency is not None:
        yield FileTimes(other.latency, settings.tuned_stage == "frame")
        return
    from hyjax.tuning.device_measuring import ConnectedDevice

    device = ConnectedDevice(other.host, other.port, lambda line: write_above_bars(f"hyjax: {line}"))
    try:
        yield ConnectedTimes(device, settings.out and settings.out / "latency.json", settings.resume)
    finally:
        device.close()


def write_request(settings: TuneSettings, path: Path) -> "LatencyRequest":
    """Write which schedules another engine is to time, for frames of these settings."""
    from hyjax.tuning.device_request import calibration_schedules, latency_request, request_text

    settings.check()
    bench = open_bench(settings, guide=open_guide(settings.guide))
    frames, _ = split_frames(len(bench.scene), settings.frames, settings.holdout)
    (case, *_), _ = bench.cases(frames[:1], "tuning", not settings.quiet)
    workload = workload_of(case)
    request = latency_request(workload, calibration_schedules(workload))
    write_text(path, request_text(request))
    return request


def _settings(
    settings: TuneSettings | None, fps: float | Sequence[float] | None, budget_ms: float | Sequence[float] | None
) -> TuneSettings:
    """Settings with budgets in the place of theirs."""
    given = {name: value for name, value in (("fps", fps), ("budget_ms", budget_ms)) if value is not None}
    budgets: Any = {name: tuple(np.atleast_1d(np.asarray(value, float)).tolist()) for name, value in given.items()}
    return dataclasses.replace(settings or TuneSettings(), **budgets)
