"""Messages of commands on stderr: one line each, without the libraries' own."""

import difflib
import errno
import itertools
import logging
import os
import re
import sys
import warnings
from typing import Any

from hyjax.util.errors import InputError, did_you_mean, one_line, shown

FILE_SECONDS = 5.0
"""Least seconds between the states of a progress bar that goes to a file."""
LONGEST_USAGE_ERROR = 400
"""Characters of a message about the command line."""
OPTION_PATTERN = re.compile(r"--[\w-]+")
"""Name of an option in such a message."""
VALUE_PATTERN = re.compile(r"Error parsing (--[\w-]+): (.*?)\[?(['\"].*['\"])\]?\.?$")
"""Option, reason and value in a message about a value."""
FORMS = {"int()": "a whole number", "INT": "a whole number", "FLOAT": "a number", "float": "a number"}
"""Words for the types of tyro's messages."""
CHOICE_PATTERN = re.compile(r"invalid choice '(.*?)' .*one of \((.*)\)")
"""Value that is no choice of its option, and the choices, in such a message."""


class OneLine(logging.Formatter):
    """A message as one line of bounded length; the traceback of an unexpected error below it stays whole."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        return one_line(super().formatMessage(record))


def open_closed_streams() -> None:
    """Put an empty file in the place of a standard stream that the shell has closed (`>&-`)."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            opened = os.open(os.devnull, os.O_RDWR)  # takes the number that is free, or is brought there
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115


def end_output(error: OSError) -> int:
    """Exit status once standard output cannot be written to; another error is raised again."""
    ended = isinstance(error, BrokenPipeError)  # the reader of our output (`| head`)
    if not ended:
        if error.filename is not None or error.errno not in (errno.ENOSPC, errno.EIO):
            raise error
        print(f"hyjax: stdout: cannot be written to: {error.strerror}", file=sys.stderr)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0 if ended else 2


def quiet_libraries() -> None:
    """Log as `hyjax: message`, one line each, without libraries' own warnings."""
    handler = _AboveBars()
    handler.setFormatter(OneLine("hyjax: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    if sys.stderr is None or not sys.stderr.isatty():
        os.environ.setdefault("TQDM_MININTERVAL", str(FILE_SECONDS))
    if sys.warnoptions:  # somebody wants to see them
        return
    warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's, of values that are checked where they matter
    warnings.showwarning = _show


class _AboveBars(logging.StreamHandler):
    """Handler of messages that stand above the progress bars."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            write_above_bars(self.format(record))
        except Exception:
            self.handleError(record)


def write_above_bars(line: str) -> None:
    """Write a line to standard error, above the progress bars, or below what a file has of them."""
    from tqdm import tqdm

    if sys.stderr is None:
        return
    if sys.stderr.isatty():
        tqdm.write(line, file=sys.stderr)
    else:
        bars = getattr(tqdm, "_instances", ())
        begun = any(bar.delay <= 0 or bar.last_print_t > bar.start_t for bar in bars)
        print("\n" * begun + line, file=sys.stderr)
    sys.stderr.flush()


def _show(message: Warning | str, *_: Any, **__: Any) -> None:
    write_above_bars(one_line(f"hyjax: {message}"))


def usage_error(box: str, command: str = "") -> str:
    """Line of a usage error that tyro has drawn as a box, with the likest of the options that it takes for meant.

    Args:
        command: first argument, which names the command where it is one.

    Example:
        >>> box = "title\\n--\\n Unrecognized options: --lihgt \\n --\\n Perhaps you meant:\\n  --lights STR"
        >>> usage_error(box, "tune")
        'Unrecognized options: --lihgt; perhaps --lights; see hyjax tune --help'
    """
    rows = [row.strip("│ ") for row in box.splitlines()]
    groups = itertools.groupby(rows[1:], key=lambda row: not row.strip("╰╯─-"))  # below the title
    said, *more = [" ".join(texts) for is_rule, texts in groups if not is_rule]
    line = one_line(said, LONGEST_USAGE_ERROR).rstrip(".")
    if parsed := VALUE_PATTERN.search(said):
        option, reason, given = parsed.groups()
        kind = next((words for form, words in FORMS.items() if form in reason), None)
        line = f"{option}: need {kind}, got {given}" if kind else f"{option}: cannot be {given}"
    if choice := CHOICE_PATTERN.search(said):
        line += did_you_mean(choice[1].lower(), re.findall(r"'(.*?)'", choice[2]))
    # tyro tells of several unknown options in any order.
    for text in sorted(more, key=lambda text: said.find((OPTION_PATTERN.findall(text) or [""])[0])):
        options = OPTION_PATTERN.findall(text)
        if text.startswith("Perhaps you meant"):
            given, *_ = OPTION_PATTERN.findall(said) or [""]
            likest = difflib.get_close_matches(given, options, 1, 0.0)[0]
            line += f"; perhaps {likest}" if likest != given else ", which other commands have"
        elif text.startswith("Arguments similar to"):  # of several unknown options
            likest = difflib.get_close_matches(options[0], options[1:], 1, 0.0)[0]
            line += f"; perhaps {likest} for {options[0]}" if likest != options[0] else ""
        elif text.startswith("Available subcommands"):
            names = text.partition(":")[2].replace(",", " ").split()
            return f"{shown(command)}: no such command{did_you_mean(command, names)}; there are {', '.join(names)}"
    return f"{line}; see hyjax {command}{' ' * bool(command)}--help"


def check_given(arguments: list[str]) -> None:
    """Raise `InputError` for an option that is given an empty text, as by an unset variable of the shell."""
    for before, argument in itertools.pairwise(["hyjax", *arguments]):
        option, equals, value = argument.partition("=") if argument.startswith("--") else (before, "=", argument)
        if equals and not value.strip():
            raise InputError(f"{option}: is given an empty text; give a value, or leave it out")
