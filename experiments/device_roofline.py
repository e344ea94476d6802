"""What presets cost on devices by their data sheets: passes, bytes, operations, and the least time they allow.

    python -m experiments.device_roofline [--size 512] [--lights 2] [--out results/device_roofline]

Takes seconds. Nothing is timed: the launches of the shaders that an exported page runs are counted. Real devices
take longer: launching takes time, memory does not reach its data sheet, and phones get hot; `hyjax tune --device`
times them.

Expect: preset hyjax moves half the bytes of paper-50, which on phones comes to about a millisecond.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import new_figure
from experiments.records import Row, of_kind
from hyjax.core.schedule import Schedule
from hyjax.device.roofline import HARDWARE, Work, least_milliseconds, work_by_kind
from hyjax.tuning.device_latency import DeviceWorkload
from hyjax.tuning.device_request import measure_program
from hyjax.util.errors import InputError

PRESETS = ("hyjax", "paper-50", "paper-80", "naive-50")
MOST = 8192


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    size: int = 512
    """Side length of square pictures."""
    lights: int = 2
    presets: tuple[str, ...] = PRESETS


@experiment("What a cascade costs on devices, by their data sheets")
def main(config: Config, start: Start) -> None:
    if not 32 <= config.size <= MOST:
        raise InputError(f"size: must lie in 32..{MOST}, got {config.size}")
    if config.lights < 1:
        raise InputError(f"lights: must be at least 1, got {config.lights}")
    schedules = [Schedule.preset(name) for name in config.presets]
    results = start()
    workload = DeviceWorkload(height=config.size, width=config.size, lights=config.lights)
    for schedule in schedules:
        program = measure_program(workload, [schedule])
        kinds = work_by_kind(program, config.lights)
        for kind, work in kinds.items():
            results.add(kind="work", schedule=schedule.name, launch=kind, **dataclasses.asdict(work))
        total = sum(kinds.values(), Work())
        least = {hardware.name: least_milliseconds(program, config.lights, hardware) for hardware in HARDWARE}
        results.add(
            kind="total", schedule=schedule.name, size=config.size, lights=config.lights, milliseconds=least,
            **dataclasses.asdict(total),
        )  # fmt: skip


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Tables and figure from the rows."""
    totals = of_kind(rows, "total")
    if not totals:
        return ["Nothing has been counted yet."]
    names = list(totals[0]["milliseconds"])
    lines = [
        [row["schedule"], *_counts(row), *(f"{row['milliseconds'][name]:.3f}" for name in names)] for row in totals
    ]
    size, lights = totals[0]["size"], totals[0]["lights"]
    caption = (
        f"Estimates, nothing is timed: least milliseconds of the diffusion of a frame, {size}², {lights} "
        "lights, by memory bandwidth and peak of the data sheets; launches are taken to cost nothing."
    )
    parts = [[row["schedule"], row["launch"], *_counts(row)] for row in of_kind(rows, "work")]
    header = ["passes", "MB read", "MB written", "million operations"]
    return [
        Table(caption, ["schedule", *header, *(f"{name}, ms" for name in names)], lines),
        Table("The same by kind of launch.", ["schedule", "launch", *header], parts, names=2),
        Plot(main.name, "Estimated least milliseconds by device.", figure(totals)),
    ]


def _counts(row: Row) -> list[str]:
    millions = (row[name] / 1e6 for name in ("read", "written", "operations"))
    return [str(row["passes"]), *(f"{value:.2f}" for value in millions)]


def figure(totals: Sequence[Row]) -> Figure:
    """Estimated least milliseconds of every schedule, a bar for each device."""
    names = list(totals[0]["milliseconds"])
    fig = new_figure(7, 1.0 + 0.2 * len(totals) * len(names))
    axes: Any = fig.subplots()
    for k, name in enumerate(names):
        places = [i + 0.8 * k / len(names) for i in range(len(totals))]
        axes.barh(places, [row["milliseconds"][name] for row in totals], 0.8 / len(names), label=name)
    axes.set_yticks([i + 0.3 for i in range(len(totals))], [row["schedule"] for row in totals])
    axes.set(xlabel="milliseconds, estimated", xscale="log")
    axes.invert_yaxis()
    axes.legend()
    return fig


if __name__ == "__main__":
    run(main)
