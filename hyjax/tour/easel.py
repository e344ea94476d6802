"""One thread that paints whatever changed last: a slider dragged fast never queues up pictures."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable
from typing import Any

QUIET = 0.2
"""Seconds without a change before coarse shadows are painted finely."""
_log = logging.getLogger(__name__)


class Easel:
    """Paints for several viewers in turns, always their latest wish.

    A viewer who asks again before the last wish was begun gets one picture, not two. When nobody asks for anything,
    drafts are painted again finely, and then jobs go on, a step at a time, so that nobody waits long for them.

    Args:
        paint: called with a viewer and whether a draft will do; returns whether a finer picture is still to come.
            What it raises is logged, and the thread goes on.
    """

    def __init__(self, paint: Callable[[Hashable, bool], bool]) -> None:
        self._paint = paint
        self._wanted: OrderedDict[Hashable, bool] = OrderedDict()  # and whether somebody is at it
        self._drafts: OrderedDict[Hashable, None] = OrderedDict()
        self._jobs: list[Generator[None]] = []
        self._changed = threading.Condition()  # its lock may be taken again by who has it
        self._last = 0.0
        self._ended = self._painting = self._ticked = False
        self._thread = threading.Thread(target=self._run, name="easel", daemon=True)

    @property
    def busy(self) -> bool:
        """Whether anything is being painted or waits for it, finer pictures among it; jobs aside."""
        with self._changed:
            return self._painting or bool(self._wanted or self._drafts)

    def start(self) -> None:
        self._thread.start()

    def want(self, *viewers: Hashable, moved: bool = True) -> None:
        """These viewers' pictures are out of date.

        Args:
            viewers: whose.
            moved: whether somebody is at it; if it is only time that has passed, drafts still become fine.
        """
        with self._changed:
            for viewer in viewers:
                self._wanted[viewer] = moved or self._wanted.get(viewer, False)
                if moved:
                    self._drafts.pop(viewer, None)
            if moved:
                self._last = time.monotonic()
            self._changed.notify()

    @property
    def pressing(self) -> bool:
        """Whether somebody waits for a picture of what they have just changed."""
        with self._changed:
            return any(self._wanted.values())

    def forget(self, viewer: Hashable) -> None:
        """This viewer has left."""
        with self._changed:
            self._wanted.pop(viewer, None)
            self._drafts.pop(viewer, None)

    def work_on(self, job: Generator[None]) -> None:
        """Go through a job's steps when there is nothing better to do."""
        with self._changed:
            self._jobs.append(job)
            self._changed.notify()

    def stop(self) -> None:
        """End the thread when what it is at is done."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        for job in self._jobs:
            job.close()  # what it has begun to write goes

    def _run(self) -> None:
        while (task := self._next()) is not None:
            try:
                task()
            except Exception:
                _log.exception("a picture of the tour could not be painted")
            self._painting = False

    def _next(self) -> Callable[[], None] | None:
        with self._changed:
            while not self._ended:
                quiet = time.monotonic() - self._last
                rest = quiet >= QUIET and not self.pressing
                # Where only time passes, what is left to do has every other turn.
                if self._wanted and not (rest and self._ticked and (self._drafts or self._jobs)):
                    self._ticked = True
                    return self._picture(self._wanted, draft=True)
                self._ticked = False
                if rest and self._drafts:
                    return self._picture(self._drafts, draft=False)
                if rest and self._jobs:
                    return self._step
                self._changed.wait(QUIET - quiet if self._drafts or self._jobs else None)
            return None

    def _picture(self, queue: OrderedDict[Hashable, Any], draft: bool) -> Callable[[], None]:
        viewer, _ = queue.popitem(last=False)
        self._painting = True

        def paint() -> None:
            if self._paint(viewer, draft):
                with self._changed:
                    if not self._wanted.get(viewer):  # else its next draft comes first
                        self._drafts[viewer] = None

        return paint

    def _step(self) -> None:
        job = self._jobs[0]
        try:
            next(job)
        except BaseException as end:
            self._jobs.remove(job)
            if not isinstance(end, StopIteration):
                raise
