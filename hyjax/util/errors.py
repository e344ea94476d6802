"""Input errors: the exception for wrong input, which the command line tells from a bug."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Wrong input: it cannot be used.

    The message is one line that says what is wrong, where, and what would be right.
    """


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean 'position'?)` for the known word nearest to a misspelt one; empty if none is near."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""
