"""Repeats of timed calls."""

from hyjax.util.errors import InputError


def check_repeats(repeats: int) -> None:
    """Raise `InputError` unless something is to be timed at least once."""
    if repeats < 1:
        raise InputError(f"repeats: must be at least 1, got {repeats}")
