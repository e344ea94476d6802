"""Typed fields of JSON files; an error names the file and the key."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import LARGEST_NUMBER, tree_json
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError


def json_object(tree: FileTree, name: str) -> dict[str, Any]:
    """The object that a JSON file of a tree holds."""
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
    """
    if default is not None and key not in fields:
        return default
    return _number(_value(fields, key, where), f"{where}: {key}", finite=True)


def json_count(fields: Mapping[str, Any], key: str, where: str) -> int:
    """A whole number of at least one, such as a picture's width."""
    number = json_number(fields, key, where)
    if not number.is_integer() or not 1 <= number <= 1 << 20:
        raise InputError(f"{where}: {key}: need a whole number from 1 to {1 << 20}, got {number:g}")
    return int(number)


def json_list(fields: Mapping[str, Any], key: str, where: str) -> list[Any]:
    """A list of an object."""
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
    """
    return number_list(_value(fields, key, where), count, f"{where}: {key}", finite=finite)


def number_list(value: Any, count: int, what: str, *, finite: bool = True) -> Float[np.ndarray, "count"]:
    """A value of a JSON file as a list of so many numbers; see `json_numbers`."""
    if not isinstance(value, list) or len(value) != count:
        got = f"{len(value)} of them" if isinstance(value, list) else _kind(value)
        raise InputError(f"{what}: need a list of {count} numbers, got {got}")
    return np.array([_number(number, f"{what}[{place}]", finite) for place, number in enumerate(value)])


class Fields:
    """An object of a JSON file by its keys, for layouts with objects in objects.

    Args:
        content: as `json` gives it.
        where: what messages call it.
    """

    def __init__(self, content: Any, where: str) -> None:
        if not isinstance(content, dict):
            raise InputError(f"{where}: need a JSON object, got {_kind(content)}")
        self._content, self.where = content, where

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; see `json_number`."""
        return json_number(self._content, key, self.where, default=default)

    def count(self, key: str) -> int:
        """A whole number of at least one; see `json_count`."""
        return json_count(self._content, key, self.where)

    def flag(self, key: str, default: bool) -> bool:
        """True or false; `default` where there is no such key."""
        value = self._content.get(key, default)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}: {key}: need true or false, got {_kind(value)}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A text; `default` where there is no such key, if one is given."""
        value = default if default is not None and key not in self else _value(self._content, key, self.where)
        if not isinstance(value, str):
            raise InputError(f"{self.where}: {key}: need a text, got {_kind(value)}")
        return value

    def numbers(self, key: str, count: int, *, finite: bool = True) -> Float[np.ndarray, "count"]:
        """A list of so many numbers; see `json_numbers`."""
        return json_numbers(self._content, key, count, self.where, finite=finite)

    def rows(self, key: str, width: int) -> Float[np.ndarray, "h width"]:
        """Lists of so many numbers each, NaN where one is not finite."""
        lists = json_list(self._content, key, self.where)
        what = f"{self.where}: {key}"
        read = [number_list(row, width, f"{what}[{place}]", finite=False) for place, row in enumerate(lists)]
        return np.array(read).reshape(-1, width)

    def objects(self, key: str) -> "list[Fields]":
        """A list of objects."""
        entries = json_list(self._content, key, self.where)
        return [Fields(entry, f"{self.where}: {key}[{place}]") for place, entry in enumerate(entries)]


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
    if abs(value) > LARGEST_NUMBER:
        raise InputError(f"{what}: need a number of at most {LARGEST_NUMBER:g}, got a larger one")
    return float(value)


def _kind(value: Any) -> str:
    names = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "null"}
    return names.get(type(value), "a number")
