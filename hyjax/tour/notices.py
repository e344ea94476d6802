"""Notices in the page of one browser."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any

import viser

from hyjax.util.errors import InputError

WAIT = ("One moment", "Compiling what this picture needs; it is kept for the next time.")
WAIT_AFTER = 0.6
"""Seconds of work before a notice says so."""
_log = logging.getLogger(__name__)


class Notices:
    """Notifications that one browser shows. All methods may be called from any thread.

    Args:
        client: the browser.
        on_refusal: called when something was refused, so that the controls show the plan again.
    """

    def __init__(self, client: viser.ClientHandle, on_refusal: Callable[[], None]) -> None:
        self._client, self._on_refusal = client, on_refusal
        self._busy: Any = None
        self._closed = False

    def notify(self, title: str, body: str, *, color: Any = "blue", seconds: float | None = 6.0) -> None:
        """Show a notice for so many seconds; until it is closed if None."""
        if not self._closed:
            self._client.add_notification(title, body, color=color, auto_close_seconds=seconds)

    def refuse(self, error: InputError) -> None:
        """Show why a request cannot be met."""
        self.notify("That does not work", str(error), color="red")

    def fail(self) -> None:
        """Show that there was an unexpected error; the log has it."""
        self.notify("Something went wrong", "See the terminal for what it was.", color="red")

    @contextlib.contextmanager
    def show_errors(self) -> Iterator[None]:
        """Show errors of the block as notices; unexpected ones are also logged."""
        try:
            yield
        except InputError as error:
            self._on_refusal()
            self.refuse(error)
        except Exception:
            _log.exception("a control of the tour failed")
            self.fail()

    @contextlib.contextmanager
    def show_wait(self) -> Iterator[None]:
        """Show a notice while the block runs, if it takes longer than `WAIT_AFTER`."""
        done, lock = threading.Event(), threading.Lock()

        def show() -> None:
            with lock:
                if not done.is_set() and not self._closed:
                    self._busy = self._client.add_notification(*WAIT, loading=True, with_close_button=False)

        timer = threading.Timer(WAIT_AFTER, show)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            with lock:
                done.set()
                if self._busy is not None:
                    self._busy.remove()
                    self._busy = None

    def close(self) -> None:
        """Show nothing more: the browser has gone."""
        self._closed = True
