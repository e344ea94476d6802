"""Start of the `hyjax` command: an interrupt is one line even while its modules load."""

import os
import signal
import sys
import threading
from typing import NoReturn

INTERRUPTED_MESSAGE = b"hyjax: interrupted; the files written so far are whole\n"


def main() -> None:
    """Entry point; see `hyjax.cli.main`."""
    # Nothing is written while modules load, and an exception in the middle of it may become any other.
    waits = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # a background job ignores it
    if waits:
        signal.signal(signal.SIGINT, _end)
    from hyjax import cli

    if waits:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()
    if waits:  # what is still compiled for the next start may be left, but not by an exception amid it
        signal.signal(signal.SIGINT, _end)
        if sys.platform != "win32":
            _end_at_once()


def _end_at_once() -> None:
    """End at an interrupt on a thread of its own: one that comes as the main thread falls asleep wakes nobody."""
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)
    signal.signal(signal.SIGINT, lambda *_: None)  # the number of the signal is written to the pipe
    signal.set_wakeup_fd(sender, warn_on_full_buffer=False)

    def wait() -> None:
        while os.read(receiver, 1) != bytes([signal.SIGINT]):
            pass
        _end()

    threading.Thread(target=wait, daemon=True).start()


def _end(*_: object) -> NoReturn:
    os.write(2, INTERRUPTED_MESSAGE)
    os._exit(130)


if __name__ == "__main__":
    main()
