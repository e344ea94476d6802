"""Dispatch of tasks in batches of about half a second, with retries and their limit."""

import itertools
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sized

from hyjax.sweep.batch import Outcome, TaskBatch, error_values, row_of
from hyjax.sweep.rows import ERROR, Row, RowStore, RowWriter
from hyjax.sweep.task import Task
from hyjax.util.errors import InputError

BATCH_SECONDS = 0.5
LARGEST_BATCH = 500
RETRIES = 3
"""Number of retries of a task that raised or took its worker along."""


class Dispatch:
    """Dispatch of tasks without a result in the store, each until it has a row.

    Args:
        tasks: each key is done once; tasks with a result are skipped.
    """

    def __init__(
        self, function: str, tasks: Iterable[Task], driver: str, store: RowStore, *, alone: bool = False
    ) -> None:
        self._function, self._driver, self._folder, self._alone = function, driver, store.folder, alone
        self._seen = store.refresh().done()
        self._left = len(tasks) if isinstance(tasks, Sized) else None
        self._tasks = (task for task in tasks if self._is_new(task))
        self._back: deque[Task] = deque()
        self._suspects: deque[Task] = deque()
        self._is_suspect = False  # whether the batch under way is one of them
        self._tries: Counter[str] = Counter()
        self._seconds: float | None = None
        self._writer: RowWriter | None = None

    def _is_new(self, task: Task) -> bool:
        if self._left is not None:
            self._left -= 1
        if task.key in self._seen:
            return False
        self._seen.add(task.key)
        return True

    def next_batch(self, places: int, under_way: int) -> TaskBatch | None:
        """Next batch, None if there is none to give out now."""
        if (self._suspects or self._is_suspect) and under_way:
            return None  # a worker that dies takes along all batches that it was given
        self._is_suspect = bool(self._suspects)
        if self._suspects:
            tasks = [self._suspects.popleft()]
        else:
            size = self._size(places)
            tasks = [self._back.popleft() for _ in range(min(size, len(self._back)))]
            tasks = tasks or list(itertools.islice(self._tasks, size))
        return TaskBatch(self._function, str(self._folder), self._driver, tuple(tasks)) if tasks else None

    def _size(self, places: int) -> int:
        if self._alone or self._seconds is None:
            return 1
        size = min(LARGEST_BATCH, max(1, round(BATCH_SECONDS / max(self._seconds, 1e-6))))
        if self._left is not None:  # the last batches are small, so that the workers end together
            size = min(size, max(1, self._left // (2 * places)))
        return size

    def finished(self, batch: TaskBatch, outcome: Outcome) -> Iterator[Row]:
        """Rows of a batch that has come back."""
        if outcome.computed:
            mean = outcome.seconds / outcome.computed
            # The first of a scene compiles: what takes less time is believed at once.
            known = mean if self._seconds is None else self._seconds
            self._seconds = min(mean, 0.5 * (known + mean))
        yield from outcome.rows
        for task in batch.tasks:
            if task.key in outcome.failed:
                yield from self._try_again(task, *outcome.failed[task.key])
        if outcome.stopped is not None:
            raise InputError(outcome.stopped)

    def unfinished(self, batch: TaskBatch) -> tuple[list[Row], list[Task]]:
        """Rows of a batch that a lost worker left, and the tasks without one."""
        store = RowStore(self._folder).refresh()
        rows = [store.get(task.key) or {} for task in batch.tasks if task.key in store]
        return rows, [task for task in batch.tasks if task.key not in store]

    def lost(self, tasks: list[Task]) -> Iterator[Row]:
        """Retry tasks whose worker died; the first of them may have been the reason."""
        if tasks:
            first, *others = tasks
            self._back.extend(others)
            yield from self._try_again(first, "WorkerLost", "every worker that was given this task died")

    def _try_again(self, task: Task, name: str, message: str) -> Iterator[Row]:
        self._tries[task.key] += 1
        if self._tries[task.key] <= RETRIES:
            self._suspects.append(task)
            return
        self._writer = self._writer or RowWriter(self._folder)
        row = row_of(task, ERROR, error_values(task, name, message), 0.0)
        self._writer.add(row)
        yield row

    def close(self) -> None:
        """Close the file of rows, if it was opened."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


Tell = Callable[[str], None]
"""Function that prints a line for the user."""
