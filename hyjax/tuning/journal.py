"""Journal of a search: its results by key, on disk as it goes, so that an interrupted search goes on."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hyjax.util.errors import InputError
from hyjax.util.run_log import Line, RunLog, as_json, check_same_settings, read_lines

NAME = "journal.jsonl"


class Journal:
    """Results by key: a file of JSON lines, the first with the settings they depend on.

    Args:
        folder: where `journal.jsonl` is kept; None keeps it in memory only.
        settings: all that decides the results, as JSON's types.
        resume: go on with the journal that is there.

    Raises:
        InputError: there is a journal and `resume` is not set, or it was written with other settings.
    """

    def __init__(self, folder: Path | None, settings: dict[str, Any], resume: bool = False) -> None:
        path = None if folder is None else folder / NAME
        header, entries = {"settings": as_json(settings)}, []
        if path is not None and path.exists():
            check_free(path.parent, resume)
            before, *entries = read_lines(path, _is_line, "an entry of a journal") or [header]
            if "settings" not in before or any("key" not in line for line in entries):
                raise InputError(f"{path}: must begin with its settings, and have results below; remove it")
            if entries:
                check_same_settings(path.parent, before["settings"], header["settings"])
        self._log = RunLog(path, [header, *entries])
        self._results = {line["key"]: line["value"] for line in entries}

    def remember(self, key: str, compute: Callable[[], Any]) -> Any:
        """Result of `compute`, which is called at most once for each key."""
        if key not in self._results:
            self._results[key] = as_json(compute())
            self._log.add({"key": key, "value": self._results[key]})
        return self._results[key]


def check_free(folder: Path, resume: bool) -> None:
    """Raise `InputError` if the folder holds a run that is not to be resumed."""
    if not resume and (folder / NAME).exists():
        raise InputError(
            f"{folder}: holds the results of another run; add --resume to go on with it, or choose another --out"
        )


def _is_line(line: Line) -> bool:
    if "settings" in line:
        return isinstance(line["settings"], dict)
    return isinstance(line.get("key"), str) and "value" in line
