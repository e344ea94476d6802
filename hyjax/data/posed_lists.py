"""Tables of poses and of pictures over time, as data sets have them in text files."""

import math

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import LARGEST_NUMBER
from hyjax.data.file_tree import FileTree
from hyjax.util.errors import InputError


def table_rows(tree: FileTree, name: str) -> list[list[str]]:
    """The rows of a text file, each its words; commas and tabs part words too, `#` begins a comment."""
    lines = (line.partition("#")[0].replace(",", " ") for line in tree.text(name).splitlines())
    return [words for words in map(str.split, lines) if words]


def floats(words: list[str], where: str, row: int) -> list[float]:
    """Numbers of a row, NaN and infinite ones too; those that no capture has are infinite."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise InputError(f"{where}: row {row} has a word that is no number: {' '.join(words)[:60]!r}") from None
    return [number if abs(number) <= LARGEST_NUMBER else number * math.inf for number in numbers]


def ascending(times: Float[np.ndarray, "n"]) -> list[int]:
    """Rows in order of time whose time is later than that of all rows before them; clocks that go back are cut."""
    kept: list[int] = []
    for row, time in enumerate(times):
        if np.isfinite(time) and (not kept or time > times[kept[-1]]):
            kept.append(row)
    return kept
