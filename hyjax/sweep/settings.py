"""Settings of a sweep. The command line takes its options, their defaults and their help from here."""

import dataclasses
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
        return self
