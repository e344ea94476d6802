"""What commands print on stderr: a line each, without the libraries' own."""

import logging
import os
import sys
import warnings
from typing import Any

from hyjax.util.errors import one_line

LONGEST = 200
"""Characters of an argument that messages about the command line may repeat."""


class OneLine(logging.Formatter):
    """A message as one line of bounded length; the traceback of an unexpected error below it stays whole."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))


def quiet_libraries() -> None:
    """Log as `hyjax: message`, a line each, and leave out what libraries say about numbers and themselves."""
    handler = logging.StreamHandler()
    handler.setFormatter(OneLine("hyjax: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    if sys.warnoptions:  # somebody wants to see them
        return
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's, of values that are checked where they matter
    warnings.showwarning = _show


def _show(message: Warning | str, *_: Any, **__: Any) -> None:
    print(one_line(f"hyjax: {message}"), file=sys.stderr)


def shortened(arguments: list[str]) -> list[str]:
    """Arguments with the middle of long ones left out, for messages.

    Example:
        >>> [len(argument) <= LONGEST for argument in shortened(["relight", "9" * 5000])]
        [True, True]
    """
    return [one_line(argument, LONGEST) if len(argument) > LONGEST else argument for argument in arguments]
