"""Logs of runs as JSON lines: whole at any moment, so that an interrupted run goes on from where it was."""

import json
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any

from hyjax.util.errors import InputError
from hyjax.util.files import append_line, write_text
from hyjax.util.reading import parse_json, read_bytes

Line = dict[str, Any]


class RunLog:
    """Lines of one run, in memory and in a file that grows by a line at a time.

    The file is written anew with the first line that is added, without what a crash cut off: a run that is refused
    before that blocks no folder.

    Args:
        path: the file; None keeps the lines in memory only.
        lines: those of the interrupted run that goes on, see `read_lines`; or a header.
    """

    def __init__(self, path: Path | None, lines: Iterable[Line] = ()) -> None:
        self.path, self.lines, self._written = path, list(lines), False

    def add(self, line: Line) -> None:
        """Append a line."""
        self.lines.append(line)
        if self.path is None:
            return
        if not self._written:
            self.write()
            return
        append_line(self.path, json.dumps(line))

    def write(self) -> None:
        """Write the file anew, with all lines."""
        if self.path is not None:
            write_text(self.path, "".join(json.dumps(line) + "\n" for line in self.lines))
            self._written = True


def read_lines(path: Path, is_line: Callable[[Line], object], what: str) -> list[Line]:
    """Read the whole lines of a file, as `is_line` knows them; the last one is left out if a crash cut it off."""
    texts = read_bytes(path).splitlines()
    lines: list[Line] = []
    for number, text in enumerate(texts, start=1):
        try:
            line = parse_json(text, str(path))
        except InputError:
            line = None
        if isinstance(line, dict) and is_line(line):
            lines.append(line)
        elif number < len(texts):
            raise InputError(f"{path}: line {number} is not {what}; remove it or the file")
    return lines


def as_json(value: Any) -> Any:
    """A value as it will be read back: lists for tuples, texts for keys."""
    return json.loads(json.dumps(value))


def check_same_settings(
    folder: Path,
    before: Line,
    now: Line,
    *,
    ignored: Collection[str] = (),
    option: Callable[[str, Any], str] | None = None,
) -> None:
    """Raise `InputError` if an interrupted run had other settings than the one that is to go on with it.

    Args:
        option: a setting, by name and value, as the command line has it; by default as Python has it.
    """
    for name in sorted(before.keys() | now.keys()):
        old, new = before.get(name), now.get(name)
        if old != new and name not in ignored:
            was, has = (option(name, old), option(name, new)) if option else (f"{name} {old!r}", repr(new))
            raise InputError(
                f"{folder}: cannot resume, that run had {was} and this one has {has}; "
                "give the same options, or choose another --out"
            )
