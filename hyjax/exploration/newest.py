"""Thread that makes the newest of what is asked for."""

import logging
import threading
from collections.abc import Callable

REST_SECONDS = 0.25
"""Seconds without a request after which a draft is followed by the whole."""
_log = logging.getLogger(__name__)


class Newest:
    """Work on the newest request, on a thread that lives while there is any; older requests are dropped.

    Args:
        work: called with whether a draft will do; returns whether the whole is still to come.
    """

    def __init__(self, work: Callable[[bool], bool]) -> None:
        self._work = work
        self._changed = threading.Condition()
        self._draft: bool | None = None
        self._drafting = False
        self._running = False
        self._thread: threading.Thread | None = None

    @property
    def superseded(self) -> bool:
        """Whether the work on hand is to be dropped for a request that was not begun.

        Work that a draft's request began never is: while a control is moved, requests come faster than it is done.
        """
        return self._draft is not None and not self._drafting

    def request(self, *, draft: bool = False) -> None:
        """Ask for the work on what is set now."""
        with self._changed:
            self._draft = draft
            if not self._running:
                self._running = True
                self._thread = threading.Thread(target=self._run, name="newest", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until all is done; whether it was in time. The work's own thread is not waited for by itself."""
        with self._changed:
            if self._thread is threading.current_thread():
                return False
            return self._changed.wait_for(lambda: not self._running, seconds)

    def _run(self) -> None:
        unfinished = False
        while True:
            with self._changed:
                if unfinished and self._draft is None:
                    self._changed.wait_for(lambda: self._draft is not None, REST_SECONDS)
                if self._draft is None and not unfinished:
                    self._running = False
                    self._changed.notify_all()
                    return
                draft, self._draft = bool(self._draft), None
                self._drafting = draft
            try:
                unfinished = self._work(draft)
            except Exception:  # later requests are worked on all the same
                _log.exception("the work on a request failed")
                unfinished = False
