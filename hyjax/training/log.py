"""Log of a training run: its settings, and a line of JSON for each update and validation."""

import json
from pathlib import Path
from typing import Any

from hyjax.training.settings import TrainSettings
from hyjax.util.errors import InputError
from hyjax.util.files import write_text
from hyjax.util.reading import read_json
from hyjax.util.run_log import Line, RunLog, as_json, check_same_settings, read_lines

FILE_NAME = "log.jsonl"
RESUMABLE_SETTINGS = ("iterations", "checkpoint_every")
"""Names of settings that a resumed run may change."""


class TrainingLog:
    """Lines of a training run, in memory and in `log.jsonl`.

    Args:
        resume: whether to go on with the run that is there.
    """

    def __init__(self, folder: Path, settings: TrainSettings, resume: bool) -> None:
        self._path, self._settings_path = folder / FILE_NAME, folder / "settings.json"
        self._settings, self._log = as_json(settings.record()), RunLog(None)
        if not self._settings_path.exists():
            return
        if not resume:
            raise InputError(
                f"{folder}: holds another training run; add --resume to go on with it, or choose another --out"
            )
        before = _read_settings(self._settings_path)
        check_same_settings(folder, before, self._settings, ignored=RESUMABLE_SETTINGS, option=_option)
        if self._path.exists():
            self._log.lines = read_lines(self._path, _is_line, "a line of a training run")

    @property
    def lines(self) -> list[Line]:
        """All lines, oldest first; each has an `iteration`."""
        return self._log.lines

    def open(self, start: int, record: dict[str, Any], write: bool = True) -> None:
        """Drop the lines after iteration `start`, from which the run goes on, and begin to write.

        Args:
            start: iteration of the checkpoint.
            write: whether this host is the one that writes.
        """
        lines = [line for line in self.lines if line["iteration"] <= start]
        self._log = RunLog(self._path if write else None, lines)
        if write:
            write_text(self._settings_path, json.dumps({"settings": self._settings} | record, indent=2) + "\n")
        self._log.write()

    def add(self, **line: Any) -> None:
        """Append a line; each has an `iteration`."""
        self._log.add(line)

    def validations(self) -> list[Line]:
        """Lines of validations, oldest first."""
        return [line for line in self.lines if "validation" in line]

    def last_is_best(self) -> bool:
        """Whether the last validation has the lowest loss so far."""
        losses = [line["validation"]["loss"] for line in self.validations()]
        return bool(losses) and losses[-1] == min(losses)


def _option(name: str, value: Any) -> str:
    """Setting in the words of the command line."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{option}" if value else f"--no-{option}"
    if value in ("", [], None):
        return f"no --{option}"
    return f"--{option} {' '.join(map(str, value)) if isinstance(value, list) else value}"


def _is_line(line: Line) -> bool:
    """Whether a line has all required keys."""
    validation = line.get("validation", {"loss": 0.0})
    return (
        type(line.get("iteration")) is int
        and isinstance(validation, dict)
        and isinstance(validation.get("loss"), int | float)
    )


def _read_settings(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("settings"), dict):
        raise InputError(f"{path}: holds no settings of a training run; choose another --out")
    return content["settings"]
