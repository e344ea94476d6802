"""The log of a training run: what it depends on, and a line of JSON for everything that happened."""

import json
from pathlib import Path
from typing import Any

from hyjax.errors import InputError
from hyjax.files import write_text
from hyjax.training.settings import TrainSettings

NAME = "log.jsonl"
GROWING = ("iterations", "checkpoint_every")
"""Settings that a resumed run may change."""


class Log:
    """Lines of a run, in memory and in `log.jsonl`.

    Args:
        folder: of the run.
        settings: written to `settings.json` by `open`.
        resume: whether to go on with the run that is there.

    Raises:
        InputError: the folder holds a run and `resume` is not set, or one with other settings.
    """

    def __init__(self, folder: Path, settings: TrainSettings, resume: bool) -> None:
        self.path, self._settings_path = folder / NAME, folder / "settings.json"
        self.lines: list[dict[str, Any]] = []
        self._record, self._writes = json.loads(json.dumps(settings.record())), False
        if not self._settings_path.exists():
            return
        if not resume:
            raise InputError(
                f"{folder}: holds another training run; add --resume to go on with it, or choose another --out"
            )
        before = _read_json(self._settings_path)["settings"]
        for name in sorted(before.keys() | self._record.keys()):
            old, new = before.get(name), self._record.get(name)
            if old != new and name not in GROWING:
                raise InputError(
                    f"{folder}: cannot resume, that run had {_option(name, old)} and this one has "
                    f"{_option(name, new)}; give the same options again, or choose another --out"
                )
        self.lines = _read_lines(self.path)

    def open(self, start: int, record: dict[str, Any], write: bool = True) -> None:
        """Forget what came after iteration `start`, from which the run goes on, and begin to write.

        Args:
            start: iteration of the checkpoint.
            record: versions and data, kept in `settings.json` beside the settings.
            write: whether this host is the one that writes.
        """
        self.lines = [line for line in self.lines if line["iteration"] <= start]
        self._writes = write
        if write:
            write_text(self._settings_path, json.dumps({"settings": self._record} | record, indent=2) + "\n")
            write_text(self.path, "".join(json.dumps(line) + "\n" for line in self.lines))

    def add(self, **line: Any) -> None:
        """Append a line; each has an `iteration`."""
        self.lines.append(line)
        if not self._writes:
            return
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise InputError(f"{self.path}: cannot write ({error.strerror or error})") from None

    def validations(self) -> list[dict[str, Any]]:
        """Lines of validations, oldest first."""
        return [line for line in self.lines if "validation" in line]

    def last_is_best(self) -> bool:
        """Whether the last validation has the lowest loss so far."""
        losses = [line["validation"]["loss"] for line in self.validations()]
        return bool(losses) and losses[-1] == min(losses)


def _option(name: str, value: Any) -> str:
    """A setting as the command line has it."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return f"--{option}" if value else f"--no-{option}"
    if value in ("", [], None):
        return f"no --{option}"
    return f"--{option} {' '.join(map(str, value)) if isinstance(value, list) else value}"


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); choose another --out") from None
    if not isinstance(content, dict) or not isinstance(content.get("settings"), dict):
        raise InputError(f"{path}: holds no settings of a training run; choose another --out")
    return content


def _read_lines(path: Path) -> list[dict[str, Any]]:
    lines: list[dict[str, Any]] = []
    if not path.exists():
        return lines
    try:
        texts = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot read ({error.strerror or error})") from None
    for text in texts:
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            break  # cut off when the run was killed; it comes after the last checkpoint
        if isinstance(line, dict) and "iteration" in line:
            lines.append(line)
    return lines
