"""Batches of tasks for a worker, which writes each row before the next task begins."""

import dataclasses
import functools
import os
import pkgutil
import platform
import socket
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hyjax.sweep.rows import ERROR, Row, RowStore, RowWriter
from hyjax.sweep.task import Task
from hyjax.util.checkout import commit
from hyjax.util.errors import InputError

Function = Callable[[dict[str, Any]], dict[str, Any]]
_opened: dict[tuple[Path, str], tuple[RowWriter, RowStore]] = {}


@dataclasses.dataclass(frozen=True)
class TaskBatch:
    """Batch of tasks for one worker.

    Attributes:
        function: `module:name`, see `name_of`.
        driver: identity of the driver; the batch ends when another has taken over.
    """

    function: str
    folder: str
    driver: str
    tasks: tuple[Task, ...]


@dataclasses.dataclass
class Outcome:
    """Outcome of a batch.

    Attributes:
        failed: exceptions of tasks, by their key.
        seconds: of the tasks that were computed.
        stopped: reason for not beginning the rest, if it concerns all tasks.
    """

    rows: list[Row] = dataclasses.field(default_factory=list)
    failed: dict[str, tuple[str, str]] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0
    computed: int = 0
    stopped: str | None = None


def name_of(function: Function) -> str:
    """Name `module:name` of a module's function, also where the module runs as `__main__`."""
    module = function.__module__
    if module == "__main__":
        spec = getattr(sys.modules[module], "__spec__", None)
        if spec is None:
            raise InputError(f"{function.__qualname__}: must be in a module that workers can import")
        module = spec.name
    if "<" in function.__qualname__:
        raise InputError(f"{function.__qualname__}: must stand at the top of its module")
    return f"{module}:{function.__qualname__}"


def run_batch(batch: TaskBatch) -> Outcome:
    """Run the tasks of a batch without a result."""
    outcome = Outcome()
    folder = Path(batch.folder)
    try:
        writer, store = _open(folder, batch.driver)
        with writer.locked():
            store.refresh()
            for task in batch.tasks:
                if task.key in store:
                    outcome.rows.append(store.get(task.key) or {})
                elif store.driver() != batch.driver:
                    outcome.stopped = f"{folder}: another run has taken over here"
                    break
                else:
                    _do(task, batch.function, writer, outcome)
    except InputError as error:
        close_rows()
        outcome.stopped = str(error)
    return outcome


def _do(task: Task, function: str, writer: RowWriter, outcome: Outcome) -> None:
    """Compute a task and write its row; an error of this task alone goes into the outcome."""
    call = pkgutil.resolve_name(function)
    start = time.perf_counter()
    try:
        values, kind = call(task.payload), task.kind
    except InputError as error:
        values, kind = error_values(task, type(error).__name__, str(error)), ERROR
    except Exception as error:
        values, kind = {}, ""
        outcome.failed[task.key] = type(error).__name__, _where(error)
    seconds = time.perf_counter() - start
    outcome.seconds += seconds
    outcome.computed += 1
    if kind:
        row = row_of(task, kind, values, seconds)
        writer.add(row)
        outcome.rows.append(row)


def row_of(task: Task, kind: str, values: dict[str, Any], seconds: float) -> Row:
    """Row of a task: its content, result and place."""
    return (
        {"key": task.key, "kind": kind}
        | task.payload
        | values
        | {
            "commit": _commit(),
            "device": _device(),
            "seed": task.payload.get("seed"),
            "seconds": round(seconds, 6),
            "worker": f"{socket.gethostname()}-{os.getpid()}",
        }
    )


def error_values(task: Task, name: str, message: str) -> dict[str, Any]:
    """Values of a task's row in place of a result."""
    return {"task": task.kind, "type": name, "error": " ".join(message.split())}


def _where(error: Exception) -> str:
    """Message and line of an exception."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{error} ({Path(place.filename).name}:{place.lineno})"


def _open(folder: Path, driver: str) -> tuple[RowWriter, RowStore]:
    """This process's file of rows for a driver, and the store of all rows."""
    if (folder, driver) not in _opened:
        close_rows()
        _opened[folder, driver] = RowWriter(folder), RowStore(folder)
    return _opened[folder, driver]


def close_rows() -> None:
    """Close this process's file of rows."""
    while _opened:
        _opened.popitem()[1][0].close()


_commit = functools.cache(commit)


def _device() -> str:
    """JAX's name of the device; the processor's where a task did without JAX."""
    if "jax" not in sys.modules:
        return f"cpu: {platform.machine()}"
    import jax

    device = jax.devices()[0]
    return f"{device.platform}: {device.device_kind}"
