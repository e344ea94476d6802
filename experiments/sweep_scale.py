"""Engine of sweeps: what many short tasks cost beside their own time, and what kills leave behind.

    python -m experiments.sweep_scale [--tasks 10000] [--task-ms 10] [--workers 2] [--out results/sweep_scale]

A task keeps a core busy for so long, in the time of its own thread. *Ideal* is that time over all tasks divided by
the workers; the overhead is what the sweep takes beyond it, on a machine that does nothing else. On a busy one look
at what the workers' seconds are beyond those of the tasks as they were, *beside tasks*, and at what all processes
compute beyond the tasks, *processor*. Memory is the driver's. Then a sweep of the size of 8 rooms x 4 set-ups x 50
configurations is run in processes of its own: undisturbed, with a worker killed twice, and with the driver killed
twice and started again. A task that was under way in a killed process is computed again; a row is never written
twice. Takes two minutes on two idle cores.

Expect: an overhead of less than 20 %, the same memory after a tenth and after all, no row lost or written twice.
"""

import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from experiments.sweep_driver import MARKS
from hyjax.sweep.rows import RowStore
from hyjax.util.cores import cores
from hyjax.util.errors import InputError

ROOMS, SETUPS, CONFIGURATIONS = 8, 4, 50
KILLS = ("nobody", "a worker, twice", "the driver, twice")
WHEN = (0.25, 0.6)
"""Shares of the tasks after which something is killed."""
PATIENCE = 300.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    tasks: int = 10_000
    task_ms: float = 10.0
    """Processor time of a task."""
    workers: int = dataclasses.field(default_factory=cores)
    """Worker processes."""
    kill_tasks: int = ROOMS * SETUPS * CONFIGURATIONS
    """Tasks of the sweeps that are killed."""


@experiment("Sweeps: overhead and kills")
def main(config: Config, start: Start) -> None:
    if config.workers < 1 or config.tasks < 10 or config.kill_tasks < 10 or not config.task_ms > 0:
        raise InputError("sweep_scale: give at least one worker, ten tasks, and a time > 0")
    results = start()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        found = json.loads(_driver(Path(folder), config.tasks, config).communicate()[0])
    ideal = config.tasks * config.task_ms / 1000 / config.workers
    results.add(kind="scale", workers=config.workers, ideal=ideal, load=load, **found)
    for killed in KILLS:
        with tempfile.TemporaryDirectory() as folder:
            results.add(kind="kills", killed=killed, **_disturbed(Path(folder), killed, config))


def _driver(folder: Path, count: int, config: Config) -> subprocess.Popen[str]:
    code = (
        "from pathlib import Path; from experiments.sweep_driver import drive; "
        f"drive(Path({str(folder)!r}), {count}, {config.task_ms}, {config.workers})"
    )
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _disturbed(folder: Path, killed: str, config: Config) -> dict[str, Any]:
    """A sweep in which something is killed, until it is done: what is in its files."""
    count, begin, told, starts = config.kill_tasks, time.perf_counter(), "", 1
    driver = _driver(folder, count, config)
    store = RowStore(folder)
    for share in () if killed == KILLS[0] else WHEN:
        end = time.monotonic() + PATIENCE
        while len(store.refresh()) < share * count and driver.poll() is None and time.monotonic() < end:
            time.sleep(0.02)
        if killed == KILLS[1]:
            os.kill(_latest_worker(folder), signal.SIGKILL)
            continue
        driver.kill()
        told += driver.communicate()[1]
        driver, starts = _driver(folder, count, config), starts + 1
    told += driver.communicate()[1]
    written = [json.loads(line)["key"] for path in store.files() for line in whole_lines(path)]
    rows = list(RowStore(folder).read())
    return {
        "tasks": count,
        "rows": len(rows),
        "twice": len(written) - len(set(written)),
        "lost": count - len(rows),
        "errors": len([row for row in rows if row["kind"] == "error"]),
        "starts": starts,
        "told": [line for line in told.splitlines() if line.startswith("hyjax:")],
        "seconds": time.perf_counter() - begin,
    }


def _latest_worker(folder: Path) -> int:
    """Process that wrote the last row."""
    path = max(RowStore(folder).files(), key=lambda path: path.stat().st_mtime_ns)
    return int(path.stem.split("-")[-2])


def whole_lines(path: Path) -> list[str]:
    """Lines of a file that a kill did not cut off."""
    return path.read_text(encoding="utf-8").split("\n")[:-1]


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Two tables from the rows."""
    found: list[Block] = []
    for row in of_kind(rows, "scale"):
        settings, seconds = row["settings"], row["seconds"]
        caption = (
            f"{settings['tasks']} tasks of {settings['task_ms']:g} ms on {row['workers']} workers; "
            f"load {row['load']:.1f} before; {machine(row)}."
        )
        overhead = 100 * (seconds["tasks"] / row["ideal"] - 1)
        whole = 100 * (sum(seconds.values()) / row["ideal"] - 1)
        processor = 100 * (row["cpu_seconds"] / (settings["tasks"] * settings["task_ms"] / 1000) - 1)
        memory = " / ".join(f"{row['memory_mib'][f'{share:g}']:.0f}" for share in MARKS)
        header = [
            "",
            "ideal (s)",
            "took (s)",
            "overhead (%)",
            "with start and end (%)",
            "beside tasks (%)",
            "processor (%)",
            "driver (MiB): 10 / 50 / 100 %",
        ]
        beside = 100 * (row["workers"] * seconds["tasks"] / row["task_seconds"] - 1)
        numbers = (row["ideal"], seconds["tasks"], overhead, whole, beside, processor)
        cells = [*(f"{number:.1f}" for number in numbers), memory]
        found.append(Table(caption, header, [["tasks", *cells]]))
    header = ["killed", "tasks", "rows", "lost", "done twice", "errors", "starts", "seconds"]
    names = ("tasks", "rows", "lost", "twice", "errors", "starts")
    lines = [
        [row["killed"], *(str(row[name]) for name in names), f"{row['seconds']:.1f}"]
        for row in of_kind(rows, "kills")
    ]
    told = list(itertools.chain.from_iterable(row["told"] for row in of_kind(rows, "kills")))
    found.append(Table("Sweeps in which something was killed (SIGKILL).", header, lines))
    return [*found, "Told: " + "; ".join(told)] if told else found


if __name__ == "__main__":
    run(main)
