"""Mappings of hand-written files: the first thing that is wrong with their keys."""

from collections.abc import Collection
from typing import Any

from hyjax.util.errors import InputError, did_you_mean, shown


def check_keys(where: str, content: Any, known: Collection[str], required: Collection[str]) -> None:
    """Check that an entry is a mapping with these keys.

    Args:
        known: keys that it may have, in the order in which they are told.
        required: those that it must have.
    """
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a mapping with {', '.join(known)}")
    for key in content:
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise InputError(f"{where}: unknown key {shown(key)}{hint}; there are {', '.join(known)}")
    for key in required:
        if key not in content:
            raise InputError(f"{where}: key {key!r} is missing")
