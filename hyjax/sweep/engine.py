"""Engine of tasks: this process, workers on this machine, or those of a Dask scheduler."""

import threading
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Protocol

from hyjax.sweep.batch import Function, Outcome, TaskBatch, close_rows, name_of, run_batch
from hyjax.sweep.dispatch import Dispatch, Tell
from hyjax.sweep.rows import Row, RowStore
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.terminal import write_above_bars


class Pool(Protocol):
    """Pool of workers for batches."""

    def places(self, timing: bool) -> int:
        """Number of batches to have under way at a time."""

    def submit(self, batch: TaskBatch, timing: bool) -> None:
        """Submit a batch."""

    def collect(self) -> list[tuple[TaskBatch, Outcome | None]]:
        """Batches ended since the last call, at least one; without outcome where the worker died."""

    def close(self) -> None:
        """End the workers."""


class Engine:
    """Engine that runs each task once, with rows in a folder. A context manager; see `open`.

    A task that raises `InputError` has a row of kind "error". One that raises anything else, or takes its worker
    along, is retried three times before it has one. Tasks with an error are done again by the next engine.
    """

    def __init__(self, folder: Path, pool: Pool, tell: Tell) -> None:
        self.folder, self._pool, self._tell = folder, pool, tell
        self._driver, self._busy = uuid.uuid4().hex, threading.Lock()

    @classmethod
    def open(
        cls,
        workers: int | None = None,
        scheduler: str | None = None,
        folder: Path = Path("swept"),
        tell: Tell | None = None,
    ) -> "Engine":
        """Open an engine with workers.

        Args:
            workers: processes on this machine; 0 for this process alone, None for one each core.
            scheduler: address of a Dask scheduler in their place. Its workers see the folder by the same name, and
                have one thread each; timing tasks go to those that were started with `--resources device=1`.
            tell: prints a line for the user; by default on stderr.
        """
        if workers is not None and workers < 0:
            raise InputError(f"workers: must be >= 0, got {workers}")
        if workers is not None and scheduler is not None:
            raise InputError("workers: a scheduler starts its own workers; give one of the two")
        make_writable(folder)
        folder, tell = folder.resolve(), tell or (lambda line: write_above_bars(f"hyjax: {line}"))
        pool: Pool = HerePool()
        if workers != 0:
            from hyjax.sweep.dask_pool import DaskPool

            pool = DaskPool.open(workers, scheduler, folder, tell)
        return cls(folder, pool, tell)

    def __enter__(self) -> "Engine":
        try:
            RowStore(self.folder).take_over(self._driver, self._tell)
        except BaseException:
            self._pool.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.close()

    def check_timing(self) -> None:
        """Raise `InputError` unless a worker has the device."""
        self._pool.places(timing=True)

    def run(self, function: Function, tasks: Iterable[Task], *, timing: bool = False) -> Iterator[Row]:
        """Run the tasks without a result in the folder; yield their rows as they come.

        Args:
            function: payload → result, at the top of a module that workers can import.
            timing: one task at a time, on a worker that has the device, and nothing else meanwhile.
        """
        if not self._busy.acquire(blocking=False):
            raise RuntimeError("the engine runs other tasks; timing must not share the device")
        work = Dispatch(name_of(function), tasks, self._driver, RowStore(self.folder), alone=timing)
        try:
            yield from self._run(work, timing)
        finally:
            work.close()
            self._busy.release()

    def _run(self, work: Dispatch, timing: bool) -> Iterator[Row]:
        under_way = 0
        while True:
            places = self._pool.places(timing)
            while under_way < places and (batch := work.next_batch(places, under_way)):
                self._pool.submit(batch, timing)
                under_way += 1
            if not under_way:
                return
            lost: list[Task] = []
            for batch, outcome in self._pool.collect():
                under_way -= 1
                if outcome is not None:
                    yield from work.finished(batch, outcome)
                    continue
                rows, tasks = work.unfinished(batch)
                lost += tasks
                yield from rows
                yield from work.lost(tasks)
            if lost:
                self._tell(f"worker lost; its {len(lost)} task{'s' * (len(lost) != 1)} run again")


class HerePool:
    """Pool of this process alone."""

    def __init__(self) -> None:
        self._batch: TaskBatch | None = None

    def places(self, timing: bool) -> int:
        return 1

    def submit(self, batch: TaskBatch, timing: bool) -> None:
        self._batch = batch

    def collect(self) -> list[tuple[TaskBatch, Outcome | None]]:
        assert self._batch is not None
        return [(self._batch, run_batch(self._batch))]

    def close(self) -> None:
        close_rows()
