"""Ctrl-C that is not lost."""

import _thread
import sys
import threading
from typing import Any

DELAY = 0.05
"""Seconds after which a lost interrupt is raised again, when the callback that lost it has returned."""


def keep_interrupts() -> None:
    """From now on raise a `KeyboardInterrupt` again that fell into a callback of a library.

    Python drops whatever is raised in a callback that C calls, such as JAX's after each garbage collection, and the
    program would go on as if nobody had pressed anything."""
    sys.unraisablehook = _raise_again


def _raise_again(unraisable: Any) -> None:
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(DELAY, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)
