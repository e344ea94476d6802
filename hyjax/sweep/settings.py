"""Settings of a sweep. The command line takes its options, their defaults and their help from here."""

import dataclasses
import re
from pathlib import Path
from typing import Annotated

import tyro

from hyjax.util.errors import InputError
from hyjax.util.settings import Settings


@dataclasses.dataclass(frozen=True)
class SweepSettings(Settings):
    """Relight scenes under light set-ups by many configurations, on all cores or a cluster, and compare."""

    spec: Annotated[Path, tyro.conf.Positional]
    """YAML or JSON file with scenes, lights, configurations, and maybe frames, size, seeds and time."""
    workers: int | None = None
    """Worker processes on this machine; 0 for none besides this one. Default: one each core."""
    scheduler: str | None = None
    """Address of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers are taken instead."""
    out: Path = Path("swept")
    """Folder for the workers' rows, rows.jsonl, summary.csv and sweep.png; one that all workers see."""
    resume: bool = False
    """Resume the sweep in the out folder: results stay, failed tasks are tried again."""
    task: str | None = None
    """Do a part of the tasks alone, 3/16 for the third of sixteen, in a folder of its own within the out folder:
    for job arrays. A last run without this, with --resume, puts the parts together."""
    quiet: bool = False
    """Hide the progress bar."""

    def check(self) -> "SweepSettings":
        """Return these settings if they are valid, as far as that is known before the start.

        Raises:
            InputError: a number out of range, or options that exclude each other.
        """
        if self.workers is not None and self.workers < 0:
            raise InputError(f"workers: must be >= 0, got {self.workers}")
        if self.workers is not None and self.scheduler is not None:
            raise InputError("workers: a scheduler starts its own workers; give one of the two")
        _ = self.part
        return self

    @property
    def part(self) -> tuple[int, int] | None:
        """Number of the part, from 1, and number of parts; None for all tasks."""
        if self.task is None:
            return None
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", self.task)
        number, count = (int(found[1]), int(found[2])) if found else (0, 0)
        if not 1 <= number <= count:
            raise InputError(
                f"task: must be a part of all, such as 3/16, from 1/16 to 16/16, got {self.task!r:.60}"
            )
        return number, count
