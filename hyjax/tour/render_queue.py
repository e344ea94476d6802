"""Render queue: one thread that renders each viewer's latest request."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable
from typing import Any

QUIET_SECONDS = 0.2
"""Seconds without an interactive request before drafts are rendered finely."""
_log = logging.getLogger(__name__)


class RenderQueue:
    """Background thread that renders for several viewers in turn, always their latest request.

    A viewer who requests again before the last request was begun gets one picture, not two. When there are no
    requests, drafts are rendered again finely, and then jobs go on, a step at a time, so that a new request never
    waits long for them.

    Args:
        render: called with a viewer and whether a draft will do; returns whether a finer picture is still to come.
            What it raises is logged, and the thread goes on.
    """

    def __init__(self, render: Callable[[Hashable, bool], bool]) -> None:
        self._render = render
        self._requests: OrderedDict[Hashable, bool] = OrderedDict()  # whether each is interactive
        self._drafts: OrderedDict[Hashable, None] = OrderedDict()
        self._jobs: list[Generator[None]] = []
        self._changed = threading.Condition()  # its lock is reentrant
        self._last_interactive = 0.0
        self._stopped = self._rendering = self._passive_turn = False
        self._thread = threading.Thread(target=self._run, name="render queue", daemon=True)

    @property
    def busy(self) -> bool:
        """Whether a picture is being rendered or is to be, finer ones included; jobs aside."""
        with self._changed:
            return self._rendering or bool(self._requests or self._drafts)

    @property
    def has_interactive(self) -> bool:
        """Whether a viewer waits for a picture of a change of their own."""
        with self._changed:
            return any(self._requests.values())

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def request(self, *viewers: Hashable, interactive: bool = True) -> None:
        """Request new pictures for these viewers.

        Args:
            interactive: whether a person has changed something. If only time has passed, as with a flickering
                candle, drafts are still rendered finely.
        """
        with self._changed:
            for viewer in viewers:
                self._requests[viewer] = interactive or self._requests.get(viewer, False)
                if interactive:
                    self._drafts.pop(viewer, None)
            if interactive:
                self._last_interactive = time.monotonic()
            self._changed.notify()

    def remove(self, viewer: Hashable) -> None:
        """Drop the requests of a viewer who has left."""
        with self._changed:
            self._requests.pop(viewer, None)
            self._drafts.pop(viewer, None)

    def add_job(self, job: Generator[None]) -> None:
        """Run a job's steps while there are no requests."""
        with self._changed:
            self._jobs.append(job)
            self._changed.notify()

    def stop(self) -> None:
        """End the thread when its present picture or step is done."""
        with self._changed:
            self._stopped = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        for job in self._jobs:
            job.close()  # which removes the files that it has begun

    def _run(self) -> None:
        while (task := self._next()) is not None:
            try:
                task()
            except Exception:
                _log.exception("a picture of the tour could not be rendered")
            self._rendering = False

    def _next(self) -> Callable[[], None] | None:
        with self._changed:
            while not self._stopped:
                since = time.monotonic() - self._last_interactive
                quiet = since >= QUIET_SECONDS and not self.has_interactive
                # While requests are not interactive, drafts and jobs have every other turn.
                if self._requests and not (quiet and self._passive_turn and (self._drafts or self._jobs)):
                    self._passive_turn = True
                    return self._picture(self._requests, draft=True)
                self._passive_turn = False
                if quiet and self._drafts:
                    return self._picture(self._drafts, draft=False)
                if quiet and self._jobs:
                    return self._step
                self._changed.wait(QUIET_SECONDS - since if self._drafts or self._jobs else None)
            return None

    def _picture(self, queue: OrderedDict[Hashable, Any], draft: bool) -> Callable[[], None]:
        viewer, _ = queue.popitem(last=False)
        self._rendering = True

        def render() -> None:
            if self._render(viewer, draft):
                with self._changed:
                    if not self._requests.get(viewer):  # else its next draft comes first
                        self._drafts[viewer] = None

        return render

    def _step(self) -> None:
        job = self._jobs[0]
        try:
            next(job)
        except BaseException as end:
            self._jobs.remove(job)
            if not isinstance(end, StopIteration):
                raise
