"""Input errors: the exception for wrong input, as opposed to a bug."""

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

LONGEST_MESSAGE = 600
"""Longest message, characters; longer ones lose their middle."""

_short = reprlib.Repr()
_short.maxlevel, _short.maxlist, _short.maxtuple, _short.maxstring, _short.maxother = 3, 8, 8, 80, 80


class InputError(ValueError):
    """Wrong input: it cannot be used.

    The message is one line that says what is wrong, where, and what would be right. Texts of files and of users may
    be in it: line ends and control characters are escaped, and the middle of a long one is left out.

    Args:
        message: the line.

    Example:
        >>> str(InputError("lamp.yaml: unknown key 'a\\nb'"))
        "lamp.yaml: unknown key 'a\\\\nb'"
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(str(message)))


def one_line(text: str, most: int = LONGEST_MESSAGE) -> str:
    """Text as one line for a terminal: unprintable characters escaped, its middle left out if long."""
    if len(text) > 4 * most:  # what is escaped would be cut anyway
        text = text[: 2 * most] + text[-2 * most :]
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
    return text if len(text) <= most else f"{text[: most * 2 // 3]} … {text[-(most // 3 - 3) :]}"


def shown(value: Any) -> str:
    """A value for a message: as Python has it, cut off where it is long or deep.

    >>> shown([0] * 1000)
    '[0, 0, 0, 0, 0, 0, 0, 0, ...]'
    """
    try:
        return _short.repr(value)
    except Exception:  # of the value's own `__repr__`
        return f"a {type(value).__name__}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean 'position'?)` for the known word that a word begins, or that is nearest; empty if none is."""
    words = list(known)
    begun = [name for name in words if len(word) > 2 and name.startswith(word)]
    cutoff = 0.51 if len(word) > 3 else 0.5
    close = sorted(begun, key=len) or difflib.get_close_matches(word[:200], words, n=1, cutoff=cutoff)
    return f" (did you mean {close[0]!r}?)" if close else ""
