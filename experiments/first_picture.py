"""Seconds until `hyjax` shows anything: its help, and the first picture with and without a filled cache folder.

    python -m experiments.first_picture [--repeats 5] [--cold 2] [--out results/first_picture]

Takes about two minutes on two idle cores. Every command is a process of its own, timed from start to end, in turns.
A cold start has an empty cache folder, in which the room is made, its light estimated and everything compiled,
and is timed until its first picture, too. The second start finds that folder, and so does one under other lights,
once for each of these folders. Programs' files are in the system's cache.

Python must be free to keep its bytecode, as it does of what is installed: with PYTHONDONTWRITEBYTECODE set, a start
takes half a second more.

Expect: help in a third of a second; imports take nearly half of a second start.
"""

import dataclasses
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from experiments.blocks import Block, Plot, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.plotting import bars
from experiments.records import Row, machine, of_kind
from hyjax.util.clock import Stopwatch
from hyjax.util.errors import InputError

IMPORTS = "import jax", "import hyjax.relighting.run"
COLD, FIRST, SECOND, OTHER = (
    "relight, cold, all frames",
    "relight, cold, until the first picture",
    "relight, second start, one frame",
    "relight, second start, one frame, other lights",
)
OTHER_LIGHTS = "golden-hour"
POLL_SECONDS = 0.05


@dataclasses.dataclass(frozen=True)
class Config(RunConfig):
    repeats: int = 5
    cold: int = 2
    """Starts with an empty cache folder."""
    size: str = "640x480"
    capture: Path | None = None
    """Capture to relight. Default: the built-in room, which a cold start also renders."""


@experiment("How long the first picture takes", "start")
def main(config: Config, start: Start) -> None:
    if config.repeats < 1 or config.cold < 1:
        raise InputError("repeats, cold: must be at least 1")
    results = start()
    with tempfile.TemporaryDirectory() as temporary:
        cache, out = Path(temporary), Path(temporary) / "out"
        relight = ["-m", "hyjax", "relight", "--quiet", "--size", config.size, "--out", str(out)]
        relight += [] if config.capture is None else ["--capture", str(config.capture)]
        calls = {f"hyjax {option}": ["-m", "hyjax", option] for option in ("--version", "--help")}
        calls |= {program: ["-c", program] for program in IMPORTS}
        for number in range(config.cold):
            shutil.rmtree(out, ignore_errors=True)
            for row in timed(COLD, relight, cache / str(number), out):
                results.add(**row)
        results.add(**stages(COLD, out))
        for number in range(config.cold):
            other = [*relight, "--frames", "0", "--lights", OTHER_LIGHTS]
            for row in timed(OTHER, other, cache / str(number)):
                results.add(**row)
        for _ in range(config.repeats):
            for name, arguments in (calls | {SECOND: [*relight, "--frames", "0"]}).items():
                for row in timed(name, arguments, cache / "0"):
                    results.add(**row)
        results.add(**stages(SECOND, out))


def timed(name: str, arguments: Sequence[str], cache: Path, out: Path | None = None) -> list[Row]:
    """Rows of a process of Python: seconds from start to end, of all cores, and the machine's load before.

    With the folder `out`, first the seconds until a relit picture is there.
    """
    before, load, watch = resource.getrusage(resource.RUSAGE_CHILDREN), os.getloadavg()[0], Stopwatch()
    rows: list[Row] = []
    with tempfile.TemporaryFile("w+") as told:
        process = subprocess.Popen(
            [sys.executable, *arguments],
            stdout=subprocess.DEVNULL,
            stderr=told,
            env=os.environ | {"HYJAX_CACHE": str(cache)},
        )
        if out is not None:
            while process.poll() is None and not any(out.glob("*.relit.png")):
                time.sleep(POLL_SECONDS)
            rows.append({"kind": "start", "start": FIRST, "seconds": watch.seconds, "load": load})
        status, seconds = process.wait(), watch.seconds
        told.seek(0)
        if status:
            raise InputError(f"{name}: failed: {told.read().strip().splitlines()[-1]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return [*rows, {"kind": "start", "start": name, "seconds": seconds, "cpu_seconds": used, "load": load}]


def stages(name: str, out: Path) -> Row:
    """Row of the stages that the last run recorded."""
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))["milliseconds"]
    return {"kind": "stages", "start": name, "first_ms": {stage: ms["first_ms"] for stage, ms in record.items()}}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table of the starts with their figure, and table of the stages."""
    starts = of_kind(rows, "start")
    names = list(dict.fromkeys(row["start"] for row in starts))
    found: list[Block] = []
    lines = []
    for name in names:
        own = [row for row in starts if row["start"] == name]
        seconds, used = (
            sorted(row["seconds"] for row in own),
            [row["cpu_seconds"] for row in own if "cpu_seconds" in row],
        )
        of_cores = f"{median(used):.2f}" if used else "–"
        lines.append([name, f"{median(seconds):.2f}", f"{seconds[0]:.2f}", of_cores, str(len(own))])
    load = (
        f"load before a start: {min(row['load'] for row in starts):.1f} to {max(row['load'] for row in starts):.1f}"
    )
    header = ["start", "median s", "fastest s", "median CPU s", "starts"]
    found.append(Table(f"{machine(starts[0])}; {load}.", header, lines))
    medians = {name: median(row["seconds"] for row in starts if row["start"] == name) for name in names}
    figure = bars(medians, [(row["start"], row["seconds"]) for row in starts], "seconds")
    found.append(Plot(main.name, "Seconds of each start (ticks) and their median (bar).", figure))
    timed_stages = {row["start"]: row["first_ms"] for row in of_kind(rows, "stages")}
    if timed_stages:
        every = list(dict.fromkeys(stage for own in timed_stages.values() for stage in own))
        table = [[stage, *(f"{own.get(stage, 0):.0f}" for own in timed_stages.values())] for stage in every]
        found.append(Table("Milliseconds by stage, of the last start each.", ["stage", *timed_stages], table))
    return found


if __name__ == "__main__":
    run(main)
