"""Parts of an experiment that do not depend on each other, on several processes: `--workers`."""

import dataclasses
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from experiments.records import Row
from hyjax.sweep.engine import Engine
from hyjax.sweep.rows import ERROR, RowStore
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError

FOLDER = "tasks"
"""Folder of the workers' rows, in that of the run."""


class Sink(Protocol):
    """Receiver of the rows of a part: the run's results, or those collected by a worker.

    Attributes:
        out: the run's folder, for pictures.
        rows: those so far.
    """

    out: Path

    @property
    def rows(self) -> list[Row]: ...

    def add(self, **values: Any) -> Row:
        """Append a row."""


@dataclasses.dataclass
class Collected:
    """Rows of a part, on their way to the run's results."""

    out: Path
    rows: list[Row] = dataclasses.field(default_factory=list)

    def add(self, **values: Any) -> Row:
        """Append a row."""
        self.rows.append(values)
        return values

    def result(self) -> dict[str, Any]:
        """Rows that a worker hands back."""
        return {"rows": json.loads(json.dumps(self.rows, default=lambda value: value.tolist()))}


def rows_of_parts(
    function: Callable[[dict[str, Any]], dict[str, Any]],
    payloads: Sequence[dict[str, Any]],
    workers: int,
    out: Path,
    *,
    resume: bool = False,
) -> Iterator[list[Row]]:
    """Rows of each part, as the parts are done.

    Args:
        function: payload → `Collected.result()`, at the top of the experiment's module.
        payloads: one a part, in JSON's types.
        workers: processes.
        out: the run's folder.
        resume: take what was done before.

    Raises:
        InputError: a part cannot be done, or Dask is not installed.
    """
    folder = out / FOLDER
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)
    tasks = [Task(payload) for payload in payloads]
    with Engine.open(workers, None, folder) as engine, tqdm(total=len(tasks), unit="part") as bar:
        store = RowStore(folder).refresh()
        done = {task.key for task in tasks if task.key in store}
        for key in done:
            bar.update()
            yield (store.get(key) or {})["rows"]
        for row in engine.run(function, tasks):
            bar.update()
            if row["kind"] == ERROR:
                raise InputError(row["error"])
            if row["key"] not in done:
                done.add(row["key"])
                yield row["rows"]
        store.refresh()
        for task in tasks:  # what workers of an earlier run still finished meanwhile
            if task.key not in done:
                bar.update()
                yield (store.get(task.key) or {})["rows"]
