"""Settings objects whose types are checked where they are made: in Python as by the command line."""

import dataclasses
import types
import typing
from pathlib import Path
from typing import Any, Literal

from hyjax.util.errors import InputError, did_you_mean


class Settings:
    """Base of settings dataclasses. Text is taken for a path and a list for a tuple where one is meant."""

    def __post_init__(self) -> None:
        for name, hint in typing.get_type_hints(type(self)).items():
            value = _converted(getattr(self, name), hint)
            if typing.get_origin(hint) is Literal and value not in typing.get_args(hint):
                known = [str(word) for word in typing.get_args(hint)]
                guess = did_you_mean(str(value), known)
                raise InputError(f"{name}: {value!r} is unknown{guess}; use one of {', '.join(known)}")
            for each in value if isinstance(value, tuple) else (value,):
                if isinstance(each, bool) and bool not in _kinds(hint):
                    raise InputError(f"{name.replace('_', ' ')}: must be a number, got {each}")
            # Most fields have their default, or are plainly of their type: typeguard takes a while to load.
            default = value is getattr(type(self), name, dataclasses.MISSING)
            plain = isinstance(value, tuple(kind for kind in _kinds(hint) if isinstance(kind, type)))
            if not (default or plain or _is_of_type(value, hint)):
                wanted = str(getattr(hint, "__name__", hint) if isinstance(hint, type) else hint)
                wanted = wanted.replace("pathlib._local.", "").replace("pathlib.", "").replace("typing.", "")
                raise InputError(f"{name.replace('_', ' ')}: must be {wanted}, got {value!r:.80}")
            object.__setattr__(self, name, value)


def _kinds(hint: Any) -> set[Any]:
    """A type, and the members of a union."""
    return {hint, *typing.get_args(hint)} if typing.get_origin(hint) in (None, types.UnionType) else {hint}


def _is_of_type(value: Any, hint: Any) -> bool:
    import typeguard

    try:
        typeguard.check_type(value, hint)
    except typeguard.TypeCheckError:
        return False
    return True


def _converted(value: Any, hint: Any) -> Any:
    kinds = _kinds(hint)
    if isinstance(value, str) and Path in kinds:
        return Path(value)
    if isinstance(value, Path) and str in kinds:
        return str(value)
    if isinstance(value, list) and typing.get_origin(hint) is tuple:
        return tuple(value)
    return value
