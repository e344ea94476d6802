"""Fields of JSON files, read with the type that they must have."""

from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import tree_json
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError


class Fields:
    """An object of a JSON file, by its keys.

    Args:
        content: as `json` gives it.
        where: what messages call it.

    Raises:
        InputError: it is no object.
    """

    def __init__(self, content: Any, where: str) -> None:
        if not isinstance(content, dict):
            raise InputError(f"{where}: must be a JSON object, is {_kind(content)}")
        self._content, self.where = content, where

    def __contains__(self, key: str) -> bool:
        return self._content.get(key) is not None

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; `default` where the key is missing, if one is given.

        Raises:
            InputError: it is none, or missing.
        """
        if key not in self and default is not None:
            return float(default)
        value = self._value(key)
        try:
            number = float("nan") if isinstance(value, str | bool) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = float("nan")
        if not np.isfinite(number):
            raise InputError(f"{self.where}: {key!r} must be a finite number, is {_kind(value)}")
        return number

    def whole(self, key: str, default: int | None = None) -> int:
        """A whole number; see `number`."""
        number = self.number(key, default)
        if not number.is_integer() or abs(number) > 2**53:
            raise InputError(f"{self.where}: {key!r} must be a whole number, is {number:g}")
        return int(number)

    def flag(self, key: str, default: bool | None = None) -> bool:
        """True or false; see `number`."""
        if key not in self and default is not None:
            return default
        value = self._value(key)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}: {key!r} must be true or false, is {_kind(value)}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A text; see `number`."""
        if key not in self and default is not None:
            return default
        value = self._value(key)
        if not isinstance(value, str):
            raise InputError(f"{self.where}: {key!r} must be a text, is {_kind(value)}")
        return value

    def numbers(self, key: str, *shapes: tuple[int, ...]) -> Float[np.ndarray, "..."]:
        """Numbers in lists of one of some shapes; NaN and infinite ones are let through.

        Raises:
            InputError: they are no numbers, not of these shapes, or missing.
        """
        value = self._value(key)
        try:
            numbers = np.asarray(value, np.float64) if _only_numbers(value) else None
        except (TypeError, ValueError, OverflowError):
            numbers = None
        if numbers is None or numbers.shape not in shapes:
            wanted = " or ".join("x".join(map(str, shape)) for shape in shapes)
            raise InputError(f"{self.where}: {key!r} must be {wanted} numbers, is {_kind(value)}")
        return numbers

    def objects(self, key: str) -> "list[Fields]":
        """A list of objects.

        Raises:
            InputError: it is none, or missing.
        """
        value = self._value(key)
        if not isinstance(value, list):
            raise InputError(f"{self.where}: {key!r} must be a list, is {_kind(value)}")
        return [Fields(entry, f"{self.where}: {key}[{number}]") for number, entry in enumerate(value)]

    def object(self, key: str) -> "Fields":
        """An object within this one; see `Fields`."""
        return Fields(self._value(key), f"{self.where}: {key!r}")

    def _value(self, key: str) -> Any:
        if key not in self:
            raise InputError(f"{self.where}: has no {key!r}")
        return self._content[key]


def tree_fields(tree: FileTree, name: str) -> Fields:
    """The object that a JSON file of a tree holds.

    Raises:
        InputError: it cannot be read, is no JSON, or holds no object.
    """
    return Fields(tree_json(tree, name), tree.where(name))


def _only_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return all(map(_only_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _kind(value: Any) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**30 else "a number of many digits"
    return text if len(text) <= 60 else f"{text[:57]}..."
