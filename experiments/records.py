"""Results as JSON lines, each with its settings, commit, device and versions, to be made again.

A run writes `rows.jsonl` in its own folder, a line at a time, so that an interrupted run goes on where it was.
Tables, figures and pages are made from these rows alone (`experiments.report`).
"""

import contextlib
import dataclasses
import datetime
import math
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hyjax.util.checkout import commit
from hyjax.util.claims import claimed
from hyjax.util.environment import environment, peak_memory_mib
from hyjax.util.errors import InputError
from hyjax.util.files import make_writable
from hyjax.util.run_log import RunLog, check_same_settings, read_lines

FILE = "rows.jsonl"
ROOT = Path(__file__).parents[1]
UNSETTLED_OPTIONS = ("out", "resume")
"""Options that decide nothing about the results."""
Row = dict[str, Any]


class Results:
    """The rows of one run.

    Every row carries `experiment`, `settings`, `seed`, `commit`, `date`, `device`, `cpu_count` and `versions`
    besides its own values. The last row of a finished run is `{"kind": "finished"}`, with the load that the machine
    had when the run began. A finished run that is there already is replaced with the first row, not before.

    Attributes:
        out: the run's folder.
        path: its file of rows.
        rows: those so far.

    Args:
        out: the run's folder.
        experiment: name of the module.
        config: the run's options, a dataclass; `out` and `resume` in it are not compared.
        resume: go on with the rows that are there.

    Raises:
        InputError: the folder cannot be written, another process writes there, it holds an interrupted run and
            `resume` is not set, or was written with other settings.
    """

    def __init__(self, out: Path, experiment: str, config: Any, *, resume: bool = False) -> None:
        make_writable(out)
        self.out, self.path = out, out / FILE
        self._load = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None  # not on Windows
        settings = {key: value for key, value in dataclasses.asdict(config).items() if key not in UNSETTLED_OPTIONS}
        self._stamp = _clean(
            {
                "experiment": experiment,
                "settings": settings,
                "seed": settings.get("seed"),
                "commit": commit(ROOT),
                "date": datetime.date.today().isoformat(),
            }
            | environment()
        )
        with contextlib.ExitStack() as claim:
            claim.enter_context(claimed(out))
            self._log = RunLog(self.path, self._rows_before(config, resume))
            self._claim = claim.pop_all()  # until the run is finished

    def _rows_before(self, config: Any, resume: bool) -> list[Row]:
        """Rows to go on with; none for a run of its own."""
        experiment, out = self._stamp["experiment"], self.out
        rows: list[Row] = []
        earlier = read_rows(self.path) if self.path.is_file() else []
        if resume:
            rows = [row for row in earlier if row.get("kind") != "finished"]
            for row in rows:
                check_same_settings(out, *({"experiment": r["experiment"]} for r in (row, self._stamp)))
                check_same_settings(out, row.get("settings") or {}, self._stamp["settings"])
        elif earlier and not is_finished(earlier):
            how = "add --resume to go on with it" if hasattr(config, "resume") else f"remove its {FILE}"
            raise InputError(
                f"{out}: holds an interrupted run of {len(earlier)} rows; {how}, or choose another --out"
            )
        elif earlier:
            print(f"{experiment}: replacing the finished run in {out}", file=sys.stderr)
        return rows

    @property
    def rows(self) -> list[Row]:
        """All rows so far."""
        return self._log.lines

    def add(self, **values: Any) -> Row:
        """Append a row and return it. Numbers that are not finite become None, arrays become lists.

        Raises:
            InputError: the file cannot be written.
            ValueError: a value has the name of something that every row carries.
        """
        if taken := sorted(values.keys() & self._stamp.keys()):
            raise ValueError(f"every row has a {taken[0]!r} already; give the value another name")
        row: Row = _clean(values) | self._stamp
        self._log.add(row)
        return row

    def finish(self) -> list[Row]:
        """Mark the run as finished and return its rows."""
        self.add(kind="finished", peak_memory_mib=round(peak_memory_mib()), load=self._load)
        self._claim.close()
        return self.rows


def read_rows(path: Path) -> list[Row]:
    """All whole rows of a file; a last line that a crash cut off is left out.

    Raises:
        InputError: no such file, or a line before the last is not a row.
    """
    return read_lines(path, lambda row: "experiment" in row, "a row of results")


def is_finished(rows: list[Row]) -> bool:
    """Whether a run came to its end."""
    return bool(rows) and rows[-1].get("kind") == "finished"


def machine(row: Row) -> str:
    """Machine that a row was made on, in words."""
    return f"{row['device']}, {row['cpu_count']} cores, jax {row['versions']['jax']}"


def size_of(rows: Sequence[Row]) -> str:
    """Size of the pictures of a run whose option is pixels a side, such as `512 x 512`."""
    return "{0} x {0}".format(rows[0]["settings"]["size"])


def of_kind(rows: Iterable[Row], kind: str) -> list[Row]:
    """The rows of a kind."""
    return [row for row in rows if row.get("kind") == kind]


def _clean(value: Any) -> Any:
    """The value in JSON's types."""
    if isinstance(value, dict):
        return {str(key): _clean(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(item) for item in value]
    if hasattr(value, "tolist"):
        return _clean(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
