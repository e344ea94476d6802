"""Latency request: which schedules a device is to time, and the program with which a page does so."""

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import msgspec

from hyjax.core.schedule import Schedule
from hyjax.device.cascade_program import CascadeWriter
from hyjax.device.frame_program import LIGHT_GROUPS
from hyjax.device.program import Groups, Program
from hyjax.tuning.calibration import calibration_steps, schedule_of
from hyjax.tuning.device_latency import FORMAT, DeviceWorkload, Form, Instant, Record
from hyjax.tuning.factors import factors_for

PRESET_NAMES = ("hyjax", "paper-50", "paper-80", "naive-50")
"""Presets in a request whose levels are among the factors, to compare with in reports."""
ROUNDS = 30
WARM_UP_SECONDS = 3.0
SAMPLE_MS = 10.0
MOST_SECONDS = 90.0


class Asked(Form, frozen=True, kw_only=True, omit_defaults=False):
    """A schedule to time.

    Attributes:
        whole: it all, as `hyjax tune` writes schedules.
    """

    whole: dict[str, Any]


class LatencyRequest(Record, frozen=True):
    """Request for times: schedules and the conditions of the timing.

    Attributes:
        format: as of the latency file.
        workload: the shapes.
        schedules: each to be timed once a round, in this order.
        rounds: how many; at least ten where they take longer than `most_seconds`.
        warm_up_seconds: how long the schedules run before the first round.
        sample_ms: how long a sample takes at least: a shorter schedule is run several times for one, and the sample
            is the time of one run.
        most_seconds: begin no further round after so long a time.
    """

    format: Literal[1]
    workload: DeviceWorkload
    schedules: tuple[Asked, ...]
    rounds: int
    warm_up_seconds: Instant
    sample_ms: float
    most_seconds: Instant


def calibration_schedules(workload: DeviceWorkload) -> list[Schedule]:
    """Schedules from whose times the costs of all others follow, and the presets."""
    factors = factors_for(workload.height, workload.width)
    schedules = [schedule_of(factors, steps) for steps in calibration_steps(factors)]
    presets = [Schedule.preset(name) for name in PRESET_NAMES]
    reached = [preset for preset in presets if {level.factor for level in preset.levels} <= set(factors)]
    return each_once([*schedules, *reached])


def each_once(schedules: Iterable[Schedule]) -> list[Schedule]:
    """Schedules that differ in their time's key, each once."""
    return list({Form.of(schedule).key: schedule for schedule in schedules}.values())


def latency_request(workload: DeviceWorkload, schedules: Sequence[Schedule]) -> LatencyRequest:
    """Request to time schedules.

    Raises:
        InputError: a schedule of which some levels have a fidelity and others none.
    """
    asked = [Asked.of(schedule, whole=msgspec.json.decode(schedule.to_json())) for schedule in schedules]
    return LatencyRequest(
        format=FORMAT,
        workload=workload,
        schedules=tuple(asked),
        rounds=ROUNDS,
        warm_up_seconds=WARM_UP_SECONDS,
        sample_ms=SAMPLE_MS,
        most_seconds=MOST_SECONDS,
    )


def measure_program(workload: DeviceWorkload, schedules: Sequence[Schedule]) -> Program:
    """Program whose stages `0`, `1`, ... are the diffusion of a frame under each schedule.

    They share buffers and shaders, so that thirty schedules need no more memory than the largest of them. λ, κ
    and α are the same in all: they do not decide the time, and so fewer shaders have to be compiled. The host
    fills `light` and `guide`.
    """
    size = workload.height, workload.width
    program = Program(size, workload.precision)
    light = program.picture("light", size, LIGHT_GROUPS)
    guide = program.picture("guide", size, Groups(-(-workload.features // 4)))
    for number, schedule in enumerate(schedules):
        writer = CascadeWriter(program, guide, workload.features, stage=str(number))
        writer.cascade("cascade", light, Form.of(schedule).schedule(), LIGHT_GROUPS, total=True)
    return program


def job(number: int, request: LatencyRequest, schedules: Sequence[Schedule]) -> dict[str, Any]:
    """Request and program as a page takes them."""
    return {
        "job": number,
        "request": msgspec.to_builtins(request, str_keys=True),
        "program": measure_program(request.workload, schedules).to_json(),
    }


def request_text(request: LatencyRequest) -> str:
    """The request as JSON, for a person and for other engines."""
    return msgspec.json.format(msgspec.json.encode(request), indent=1).decode() + "\n"
