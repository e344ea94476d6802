"""Typed fields of JSON files; an error names the file and the key."""

from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import LARGEST_NUMBER, tree_json
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError


class Fields:
    """An object of a JSON file by its keys."""

    def __init__(self, content: Any, where: str) -> None:
        if not isinstance(content, dict):
            raise InputError(f"{where}: need a JSON object, got {_kind(content)}")
        self._content, self.where = content, where

    @classmethod
    def of(cls, tree: FileTree, name: str) -> "Fields":
        """The object that a JSON file of a tree holds."""
        return cls(tree_json(tree, name), tree.where(name))

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def number(self, key: str, default: float | None = None, *, finite: bool = True) -> float:
        """A number.

        Args:
            finite: whether NaN and infinite numbers, which some programs write for an unknown pose, are refused.
        """
        if default is not None and key not in self:
            return default
        return _number(self._value(key), f"{self.where}: {key}", finite)

    def count(self, key: str) -> int:
        """A whole number of at least one, such as a picture's width."""
        number = self.number(key)
        if not number.is_integer() or not 1 <= number <= 1 << 20:
            raise InputError(f"{self.where}: {key}: need a whole number from 1 to {1 << 20}, got {number:g}")
        return int(number)

    def flag(self, key: str, default: bool) -> bool:
        """True or false; `default` where there is no such key."""
        value = self._content.get(key, default)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}: {key}: need true or false, got {_kind(value)}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A text; `default` where there is no such key, if one is given."""
        value = default if default is not None and key not in self else self._value(key)
        if not isinstance(value, str):
            raise InputError(f"{self.where}: {key}: need a text, got {_kind(value)}")
        return value

    def numbers(self, key: str, count: int | None = None, *, finite: bool = True) -> Float[np.ndarray, "count"]:
        """A list of so many numbers, or of any number of them; NaN where one is not finite and may be."""
        return _numbers(self._value(key), count, f"{self.where}: {key}", finite)

    def rows(self, key: str, width: int, *, finite: bool = False) -> Float[np.ndarray, "h width"]:
        """Lists of so many numbers each; see `numbers`."""
        read = [_numbers(row, width, where, finite) for row, where in self._list(key)]
        return np.array(read).reshape(-1, width)

    def objects(self, key: str) -> "list[Fields]":
        """A list of objects."""
        return [Fields(entry, where) for entry, where in self._list(key)]

    def _list(self, key: str) -> list[tuple[Any, str]]:
        """Entries of a list, each with its name for messages."""
        value = self._value(key)
        if not isinstance(value, list):
            raise InputError(f"{self.where}: {key}: need a list, got {_kind(value)}")
        return [(entry, f"{self.where}: {key}[{place}]") for place, entry in enumerate(value)]

    def _value(self, key: str) -> Any:
        if key not in self._content:
            raise InputError(f"{self.where}: {key} is missing")
        return self._content[key]


def _numbers(value: Any, count: int | None, what: str, finite: bool) -> Float[np.ndarray, "count"]:
    if not isinstance(value, list) or len(value) != (len(value) if count is None else count):
        got = f"{len(value)} of them" if isinstance(value, list) else _kind(value)
        raise InputError(f"{what}: need a list of {count or ''} numbers, got {got}")
    return np.array([_number(number, f"{what}[{place}]", finite) for place, number in enumerate(value)])


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
