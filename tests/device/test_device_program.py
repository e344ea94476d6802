"""Programs by what they ask of a device, without one."""

import re
from pathlib import Path
from typing import get_args

import pytest

import hyjax.device
from hyjax.configuration import Configuration
from hyjax.core.schedule import PRESETS, Schedule
from hyjax.device.frame_program import SceneCounts, frame_program
from hyjax.device.precision_check import precision_check
from hyjax.device.program import Precision, Program
from hyjax.light.color import SHOULDER, WHITE
from hyjax.light.emission import LAMP_BRIGHT, LAMP_DARK, PANE_WHITE

MOST_STORAGE_BUFFERS, MOST_WORKGROUP_BYTES, MOST_UNIFORM_BYTES, MOST_BINDING_BYTES = 8, 16384, 65536, 1 << 27
"""Default limits of WebGPU."""
COUNTS = SceneCounts(20_000, 10_500, 11_000, 128, 4, 20_000, 10_500)
WGSL_BYTES = {"f32": 4, "u32": 4, "vec2<f32>": 8, "vec4<f32>": 16, "vec4<u32>": 16}

PLANES = {"surface": 2, "shade": 3, "fill": 2}
"""Planes of the light that shaders take part of: there are five, for four lights."""


def programs(precision: Precision) -> list[Program]:
    configuration = Configuration()
    schedules = [configuration.schedule, *(Schedule.preset(name) for name in PRESETS)]
    frames = [
        frame_program(COUNTS, (480, 640), schedule, configuration.shadow_schedule, precision=precision, features=n)
        for schedule in schedules
        for n in (3, 16)
    ]
    return [*frames, precision_check(precision)]


@pytest.mark.parametrize("precision", get_args(Precision))
def test_default_limits_are_kept(precision: Precision) -> None:
    for program in programs(precision):
        for name, text in program.shaders.items():
            assert len(re.findall(r"var<storage", text)) <= MOST_STORAGE_BUFFERS, name
            shared = re.findall(r"var<workgroup> \w+: array<([\w<>]+), (\d+)>", text)
            assert len(shared) == text.count("var<workgroup>")
            assert sum(WGSL_BYTES[kind] * int(count) for kind, count in shared) <= MOST_WORKGROUP_BYTES, name
        for name, buffer in program.buffers.items():
            most = MOST_UNIFORM_BYTES if buffer.uniform else MOST_BINDING_BYTES
            assert buffer.bytes * buffer.groups.count(4) <= most, name


def test_the_curve_of_the_shaders_is_ours() -> None:
    text = Path(hyjax.device.__path__[0], "wgsl", "color.wgsl").read_text()
    for name, value in (("SHOULDER", SHOULDER), ("WHITE", WHITE)):
        assert f"const {name} = {value};" in text
    text = Path(hyjax.device.__path__[0], "wgsl", "composite.wgsl").read_text()
    for name, value in (("LAMP_DARK", LAMP_DARK), ("LAMP_BRIGHT", LAMP_BRIGHT), ("PANE_WHITE", PANE_WHITE)):
        assert f"const {name} = {value};" in text


def test_a_picture_takes_few_passes_and_little_traffic() -> None:
    """At 640x480 with four lights, in half precision: what launches read and write of pictures, each once."""
    configuration = Configuration()
    program = frame_program(
        COUNTS, (480, 640), configuration.schedule, configuration.shadow_schedule, precision="f16", stages=False
    )
    launches = [launch for launch in program.launches if launch.stage == "frame"]
    assert len(launches) <= 30
    plane = 8 * 480 * 640
    traffic = 0
    for launch in launches:
        shader = launch.shader.split("-")[0]
        for name in set(launch.bind) & set(program.buffers):
            buffer = program.buffers[name]
            whole = buffer.bytes * buffer.groups.count(4)
            traffic += PLANES[shader] * plane if name == "light" and shader in PLANES else whole
    print(f"{len(launches)} passes, {traffic / 1e6:.0f} MB")
    assert traffic <= 100e6
