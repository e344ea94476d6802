"""Rows of a kept file: names and values that consecutive rows share are written once."""

import itertools
import json
from collections.abc import Iterator, Sequence
from typing import Any

SHAPE = "rows of"
"""Key of a line that says how the lists after it are rows: null where a row has a value of its own."""


def packed(rows: Sequence[dict[str, Any]]) -> list[Any]:
    """Lines for rows: a shape and a list of values for each row that has it; a row that is alone stays.

    >>> packed([{"kind": "time", "of": {"a": 1}}, {"kind": "time", "of": {"a": 2}}, {"kind": "end"}])
    [{'rows of': {'kind': 'time', 'of': {'a': None}}}, [1], [2], {'kind': 'end'}]
    """
    lines: list[Any] = []
    for _, group in itertools.groupby(rows, key=lambda row: json.dumps(_filled(row, itertools.repeat(None)))):
        alike = list(group)
        if len(alike) == 1:
            lines += alike
            continue
        values = [list(_leaves(row)) for row in alike]
        shared = [column[0] if len(set(map(json.dumps, column))) == 1 else None for column in zip(*values)]
        lines.append({SHAPE: _filled(alike[0], iter(shared))})
        lines += [[value for value, common in zip(row, shared) if common is None] for row in values]
    return lines


def unpacked(lines: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Rows of the lines.

    >>> list(unpacked([{"rows of": {"kind": "time", "ms": None}}, [1.5], [2.5], {"kind": "end"}]))
    [{'kind': 'time', 'ms': 1.5}, {'kind': 'time', 'ms': 2.5}, {'kind': 'end'}]
    """
    shape: dict[str, Any] = {}
    for line in lines:
        if isinstance(line, list):
            own = iter(line)
            yield _filled(shape, (next(own) if value is None else value for value in _leaves(shape)))
        elif line.keys() == {SHAPE}:
            shape = line[SHAPE]
        else:
            yield line


def _leaves(value: Any) -> Iterator[Any]:
    """Values of a row, those of dictionaries within it one by one."""
    if isinstance(value, dict):
        yield from itertools.chain.from_iterable(map(_leaves, value.values()))
    else:
        yield value


def _filled(row: Any, values: Iterator[Any]) -> Any:
    """A row with other values."""
    return {key: _filled(value, values) for key, value in row.items()} if isinstance(row, dict) else next(values)
