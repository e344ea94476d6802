"""Interrupts (Ctrl-C) that are raised in the main thread, wherever they arrive."""

import _thread
import contextlib
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NoReturn

DELAY = 0.05
"""Seconds, twice: until the callback that lost an interrupt has returned, and until the main thread sleeps."""


def defer_interrupts() -> None:
    """Raise again, from now on, a `KeyboardInterrupt` that fell into a callback of a library.

    Python drops whatever is raised in a callback that C calls, such as JAX's after each garbage collection, and the
    program would go on as if nothing had been pressed."""
    before = sys.unraisablehook
    if not (isinstance(before, functools.partial) and before.func is _raise_again):
        sys.unraisablehook = functools.partial(_raise_again, before)


def exit_now(status: int) -> NoReturn:
    """End an interrupted process at once: XLA may still be computing, which Python's own end may not survive."""
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def _raise_again(before: Callable[[Any], Any], unraisable: Any) -> None:
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(DELAY, _interrupt).start()
    else:
        before(unraisable)


def _interrupt() -> None:
    # A signal that falls between the main thread's letting go of the interpreter and its going to sleep wakes
    # nobody, and that is just when this thread comes to run if it had to wait: let it fall asleep first.
    time.sleep(DELAY)
    if hasattr(signal, "pthread_kill"):  # a real signal also ends what sleeps or waits
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)  # type: ignore[arg-type]
    else:
        _thread.interrupt_main()
