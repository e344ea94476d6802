"""Driver of `experiments.sweep_scale` and what its workers do, in a module that loads little."""

import json
import os
import time
from pathlib import Path
from typing import Any

from hyjax.sweep.engine import Engine
from hyjax.sweep.task import Task

MARKS = (0.1, 0.5, 1.0)
"""Shares of the tasks after which the driver's memory is looked at."""


def busy(payload: dict[str, Any]) -> dict[str, Any]:
    """Work for so long, in the time of this thread."""
    end, turns = time.thread_time() + payload["ms"] / 1000, 0
    while time.thread_time() < end:
        turns += 1
    return {"loss": 1.0 / turns}


def drive(folder: Path, count: int, task_ms: float, workers: int) -> None:
    """A driver, for a process of its own: prints its seconds and memory as JSON."""
    tasks = (Task({"number": number, "ms": task_ms}) for number in range(count))
    marks = {max(1, round(count * share)): f"{share:g}" for share in MARKS}
    memory: dict[str, float] = {}
    task_seconds = 0.0
    begin = time.perf_counter()
    with Engine.open(workers, None, folder) as engine:
        ready = time.perf_counter()
        for number, row in enumerate(engine.run(busy, tasks), start=1):
            task_seconds += row["seconds"]
            if number in marks:
                memory[marks[number]] = round(resident_mib(), 1)
        done = time.perf_counter()
    seconds = {"start": ready - begin, "tasks": done - ready, "end": time.perf_counter() - done}
    times = {"seconds": seconds, "task_seconds": task_seconds, "cpu_seconds": cpu_seconds()}
    print(json.dumps(times | {"memory_mib": memory}))


def cpu_seconds() -> float:
    """Processor time of this process and of those that it started and that have ended, from their first moment."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def resident_mib() -> float:
    """Memory of this process; NaN where the system does not tell."""
    statm = Path("/proc/self/statm")
    if not statm.is_file():
        return float("nan")
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
