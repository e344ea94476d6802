"""Mappings of hand-written files: the first thing that is wrong with their keys, or with a value."""

import re
from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from hyjax.util.errors import InputError, did_you_mean, shown

WORDS = {"`float`": "a number", "`int`": "a whole number", "`array`": "a list", "`bool`": "true or false"}
"""Words of msgspec, and plain ones."""


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


def converted(where: str, content: Any, kind: type[Any], forms: Mapping[str, str]) -> Any:
    """An entry as a struct of msgspec; `forms` say what keys must be, msgspec those that are left out."""
    fields = msgspec.structs.fields(kind)
    check_keys(where, content, [f.name for f in fields], [f.name for f in fields if f.required])
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        at = re.search(r"\$\.(\w+)", str(error))
        key = at[1] if at else fields[0].name
        form = forms.get(key) or re.sub(r"Expected |(, got| - at).*", "", str(error))
        for word, plain in WORDS.items():
            form = form.replace(word, plain)
        raise InputError(f"{where}: {key!r} must be {form}, got {content.get(key)!r:.80}") from None
