"""Typed fields of JSON files: each is what the reader needs, or one line names the file and the key."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import tree_json
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError

LARGEST = 1e16
"""Of a number in a capture's file; microseconds since 1970 are the largest that any app writes."""


def json_object(tree: FileTree, name: str) -> dict[str, Any]:
    """The object that a JSON file of a tree holds.

    Raises:
        InputError: it cannot be read, or holds something else.
    """
    content = tree_json(tree, name)
    if not isinstance(content, dict):
        raise InputError(f"{tree.where(name)}: need a JSON object, got {_kind(content)}")
    return content


def json_number(fields: Mapping[str, Any], key: str, where: str, *, default: float | None = None) -> float:
    """A finite number of an object.

    Args:
        fields: the object.
        key: in it.
        where: the file, for messages.
        default: where there is no such key; None if there must be one.

    Raises:
        InputError: there is none, or it is no finite number.
    """
    if default is not None and key not in fields:
        return default
    return _number(_value(fields, key, where), f"{where}: {key}", finite=True)


def json_count(fields: Mapping[str, Any], key: str, where: str) -> int:
    """A whole number of at least one, such as a picture's width.

    Raises:
        InputError: there is none, or it is another number.
    """
    number = json_number(fields, key, where)
    if not number.is_integer() or not 1 <= number <= 1 << 20:
        raise InputError(f"{where}: {key}: need a whole number from 1 to {1 << 20}, got {number:g}")
    return int(number)


def json_list(fields: Mapping[str, Any], key: str, where: str) -> list[Any]:
    """A list of an object.

    Raises:
        InputError: there is none.
    """
    value = _value(fields, key, where)
    if not isinstance(value, list):
        raise InputError(f"{where}: {key}: need a list, got {_kind(value)}")
    return value


def json_numbers(
    fields: Mapping[str, Any], key: str, count: int, where: str, *, finite: bool = True
) -> Float[np.ndarray, "count"]:
    """A list of so many numbers of an object.

    Args:
        fields: the object.
        key: in it.
        count: of numbers.
        where: the file, for messages.
        finite: whether NaN and infinite numbers, which some programs write for an unknown pose, are refused.

    Raises:
        InputError: there is none, or it is another list.
    """
    return number_list(_value(fields, key, where), count, f"{where}: {key}", finite=finite)


def number_list(value: Any, count: int, what: str, *, finite: bool = True) -> Float[np.ndarray, "count"]:
    """A value of a JSON file as a list of so many numbers; see `json_numbers`."""
    if not isinstance(value, list) or len(value) != count:
        got = f"{len(value)} of them" if isinstance(value, list) else _kind(value)
        raise InputError(f"{what}: need a list of {count} numbers, got {got}")
    return np.array([_number(number, f"{what}[{place}]", finite) for place, number in enumerate(value)])


def _value(fields: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in fields:
        raise InputError(f"{where}: {key} is missing")
    return fields[key]


def _number(value: Any, what: str, finite: bool) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{what}: need a number, got {_kind(value)}")
    if isinstance(value, float) and not np.isfinite(value):
        if finite:
            raise InputError(f"{what}: need a finite number, got {value}")
        return float("nan")
    if abs(value) > LARGEST:
        raise InputError(f"{what}: need a number of at most {LARGEST:g}, got a larger one")
    return float(value)


def _kind(value: Any) -> str:
    names = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "null"}
    return names.get(type(value), "a number")
