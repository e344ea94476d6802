"""What a search has computed, on disk as it goes, so that an interrupted one goes on from where it was."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hyjax.errors import InputError
from hyjax.files import write_text

NAME = "journal.jsonl"


class Journal:
    """Remembers results by key: a file of JSON lines, the first with the settings they depend on.

    Lines are appended; the last one, cut off by a crash, is ignored when the file is read again.

    Args:
        folder: where `journal.jsonl` is kept; None keeps it in memory only.
        settings: all that decides the results, as JSON's types.
        resume: go on with the journal that is there.

    Raises:
        InputError: there is a journal and `resume` is not set, or it was written with other settings.
    """

    def __init__(self, folder: Path | None, settings: dict[str, Any], resume: bool = False) -> None:
        self.known: dict[str, Any] = {}
        self.path = None if folder is None else folder / NAME
        if self.path is None:
            return
        self.settings = json.loads(json.dumps(settings))
        check_free(self.path.parent, resume)
        lines = self._read()
        if len(lines) > 1 and "settings" in lines[0]:
            _compare(self.path.parent, lines[0]["settings"], self.settings)
            self.known = {line["key"]: line["value"] for line in lines[1:] if "key" in line}
            self._write()  # without what a crash cut off

    def remember(self, key: str, compute: Callable[[], Any]) -> Any:
        """What `compute` returns, computed at most once for each key."""
        if key not in self.known:
            self.known[key] = json.loads(json.dumps(compute()))  # as it will be read back
            if self.path is not None and len(self.known) == 1:
                self._write()  # not before: a run that was refused blocks no folder
            elif self.path is not None:
                self._append(self.path, {"key": key, "value": self.known[key]})
        return self.known[key]

    def _write(self) -> None:
        assert self.path is not None
        entries = [{"settings": self.settings}, *({"key": k, "value": v} for k, v in self.known.items())]
        write_text(self.path, "".join(json.dumps(entry) + "\n" for entry in entries))

    def _append(self, path: Path, entry: dict[str, Any]) -> None:
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        except OSError as error:
            raise InputError(f"{path}: cannot write ({error.strerror or error})") from None

    def _read(self) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = []
        if self.path is None or not self.path.is_file():
            return lines
        try:
            text = self.path.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(f"{self.path}: cannot read ({error.strerror or error})") from None
        for line in text.splitlines():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                break  # cut off by a crash: nothing after it was acted upon
            if not isinstance(entry, dict) or not ("settings" in entry or {"key", "value"} <= entry.keys()):
                break
            lines.append(entry)
        return lines


def check_free(folder: Path, resume: bool) -> None:
    """Raise `InputError` if the folder holds a run that is not to be resumed."""
    if not resume and (folder / NAME).exists():
        raise InputError(
            f"{folder}: holds the results of another run; add --resume to go on with it, or choose another --out"
        )


def _compare(folder: Path, old: dict[str, Any], new: dict[str, Any]) -> None:
    for key in sorted(old.keys() | new.keys()):
        if old.get(key) != new.get(key):
            raise InputError(
                f"{folder}: cannot resume, that run had {key} {old.get(key)!r} and this one has {new.get(key)!r}; "
                "give the same options, or choose another --out"
            )
