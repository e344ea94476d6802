"""Start of the `hyjax` command: an interrupt is one line even while its modules load."""

import gc
import os
import signal
from typing import NoReturn

INTERRUPTED_MESSAGE = b"hyjax: interrupted; the files written so far are whole\n"


def main() -> None:
    """Entry point; see `hyjax.cli.main`."""
    # Nothing is written while modules load, and an exception in the middle of it may become any other.
    waits = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # a background job ignores it
    if waits:
        signal.signal(signal.SIGINT, _end)
    gc.disable()  # until the command is known: modules make many objects, and little garbage
    from hyjax import cli

    if waits:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()
    if waits:  # what is still compiled for the next start may be left, but not by an exception amid it
        signal.signal(signal.SIGINT, _end)


def _end(*_: object) -> NoReturn:
    os.write(2, INTERRUPTED_MESSAGE)
    os._exit(130)


if __name__ == "__main__":
    main()
