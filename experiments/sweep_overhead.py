"""Time that the engine of `hyjax sweep` takes beside short tasks.

    pip install -e ".[tune]"
    python -m experiments.sweep_overhead [--tasks 5000] [--workers 2] [--out results/sweep_overhead]

Each task works a processor for so many milliseconds and does nothing else; batches of them, rows on disk, and the
driver's part are the engine's as in any sweep. Starting the workers is told apart. On an idle machine alone the
figure means something: a task that waits for a processor is counted with the engine.

Takes half a minute.

Expect: at 10 ms a task less than a twentieth.
"""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.blocks import Block, Table
from experiments.command import RunConfig, Start, experiment, run
from experiments.records import Row, machine, of_kind
from hyjax.sweep.engine import Engine
from hyjax.sweep.task import Task


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config(RunConfig):
    tasks: int = 5000
    milliseconds: float = 10.0
    """Of each task."""
    workers: int = 2


@experiment("Overhead of a sweep", "overhead")
def main(config: Config, start: Start) -> None:
    import distributed  # noqa: F401  its configuration wants the main thread

    results = start()
    tasks = [Task({"number": n, "milliseconds": config.milliseconds}) for n in range(config.tasks)]
    begun = time.perf_counter()
    with Engine.open(config.workers, None, results.out / "swept") as engine:
        opened = time.perf_counter()
        seconds = [row["seconds"] for row in engine.run(work, tasks)]
        ended = time.perf_counter()
    results.add(kind="overhead", start=opened - begun, took=ended - opened, tasks=sum(seconds), rows=len(seconds))


def work(payload: dict[str, Any]) -> dict[str, Any]:
    """A task of so much processor time."""
    end = time.process_time() + payload["milliseconds"] / 1e3
    while time.process_time() < end:
        pass
    return {"done": payload["number"]}


def blocks(rows: Sequence[Row], folder: Path) -> list[Block]:
    """Table from the rows."""
    lines = []
    for row in of_kind(rows, "overhead"):
        settings = row["settings"]
        ideal = settings["tasks"] * settings["milliseconds"] / 1e3 / settings["workers"]
        inside = row["tasks"] / settings["workers"]
        cells = [str(row["rows"]), f"{settings['milliseconds']:g}", str(settings["workers"])]
        cells += [f"{x:.1f}" for x in (ideal, row["took"], 100 * (row["took"] / ideal - 1))]
        lines.append([*cells, f"{100 * (row['took'] / inside - 1):.1f}", f"{row['start']:.1f}"])
    header = [
        "tasks",
        "ms each",
        "workers",
        "ideal (s)",
        "took (s)",
        "overhead (%)",
        "beside tasks (%)",
        "start (s)",
    ]
    caption = (
        "Overhead over the ideal time, and over the tasks' own seconds, which other work lengthens; "
        f"{machine(of_kind(rows, 'overhead')[0])}."
    )
    return [Table(caption, header, lines, names=0)]


if __name__ == "__main__":
    run(main)
