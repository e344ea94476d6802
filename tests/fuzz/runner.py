"""Many cases, one after the other, in a process that may die of them.

The process has a limit of memory; whoever watches it has one of time.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

SECONDS = 5.0
"""Processor time of one case."""
HANGS = 30.0
"""Seconds by the clock after which a case waits for something."""
TO_START = 120.0
"""Seconds until the first case: imports, and the seeds."""
ROOT = Path(__file__).parents[2]
MEMORY = "/dev/shm"
Row = dict[str, Any]


def run(names: Sequence[str], cases: range, seed: int, kept: Path, seconds: float | None = None) -> Iterator[Row]:
    """A row for each reader: how many cases gave what, the worst time and memory, the first that were not right.

    Args:
        names: of the readers.
        cases: numbers of the cases.
        seed: of all cases.
        kept: folder for the files of cases that were not right.
        seconds: for each reader, after which no new case begins; None for all cases.
    """
    left = [(name, cases.start) for name in names]
    row = _empty(left[0][0], seed)
    while left:
        with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else None) as folder:
            task = {"left": left, "stop": cases.stop, "seed": seed, "kept": str(kept), "seconds": seconds}
            process = _Watched(Path(folder), task)
            for told in process.rows():
                _add(row, told)
                if told["done"]:
                    yield row
                    left = left[1:]
                    row = _empty(left[0][0], seed) if left else row
            if process.end and left:
                number = process.number
                _add(row, {"counts": {"other": 1}, "others": [{"case": number, "note": process.end}]})
                left = [(left[0][0], number + 1), *left[1:]]


def _empty(name: str, seed: int) -> Row:
    counts = dict.fromkeys(("cases", "result", "InputError", "other"), 0)
    return {"reader": name, "seed": seed, **counts, "worst_seconds": 0.0, "worst_mib": 0, "others": []}


def _add(row: Row, told: Row) -> None:
    for kind, count in told["counts"].items():
        row[kind] += count
        row["cases"] += count
    for name in ("worst_seconds", "worst_mib"):
        row[name] = max(row[name], told.get(name, 0))
    row["others"] = (row["others"] + told["others"])[:20]


class _Watched:
    """A worker's process; killed when a case takes too long.

    Attributes:
        end: why it ended early; empty if it did not.
        number: of the case it ended in.
    """

    def __init__(self, folder: Path, task: Row) -> None:
        self.end, self.number = "", 0
        self._beat, self._log = folder / "beat", folder / "log"
        self._beat.write_text("")
        arguments = [sys.executable, "-m", "tests.fuzz.worker", json.dumps(task | {"folder": str(folder)})]
        with self._log.open("w") as log:
            self._process = subprocess.Popen(arguments, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)

    def rows(self) -> Iterator[Row]:
        """What it tells, as it comes."""
        last, since, ended = "", time.monotonic(), False
        with self._log.open() as log:
            while not ended:
                time.sleep(0.05)
                ended = self._process.poll() is not None
                beat = self._beat.read_text()
                if beat != last:
                    last, since = beat, time.monotonic()
                elif time.monotonic() - since > (HANGS if beat else TO_START):
                    self._process.kill()
                    self._process.wait()
                    self.end, ended = f"over {HANGS:g} s", True
                for line in log:
                    if line.startswith('{"counts"'):
                        yield json.loads(line)
        if self._process.returncode:
            end = " ".join(self._log.read_text().splitlines()[-3:])[-300:]
            self.end = self.end or f"the process ended with {self._process.returncode}: {end}"
            if not self._beat.read_text():
                raise RuntimeError(self.end)
            self.number = int(self._beat.read_text())
