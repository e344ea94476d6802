"""Experiments as one file each: the decorator that makes one of a module's `main`, and its command line.

    @experiment("Title in the report")
    def main(config: Config, start: Start) -> None:
        results = start()
        results.add(kind="score", ...)

    def blocks(rows, folder): ...

    if __name__ == "__main__":
        run(main)

The line in `experiments.EXPERIMENTS` puts it into the report.
"""

import dataclasses
import functools
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tyro

from experiments.blocks import Block, write_blocks
from experiments.provenance import provenance
from experiments.records import Results, Row, of_kind
from hyjax.util.errors import InputError
from hyjax.util.interrupts import defer_interrupts, exit_now

Start = Callable[..., Results]
"""Opens the run's results; with the capture's name they go into a folder of that name."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Options of every experiment. One that has `resume: bool` besides can go on with an interrupted run."""

    out: Path | None = None
    """Folder for the results. Default: results/EXPERIMENT, with many captures results/EXPERIMENT/CAPTURE."""


def bind_to_cores(count: int) -> None:
    """Bind this process to so many of its cores; before XLA and torch start their threads.

    Raises:
        InputError: this system cannot do it, or there are not as many.
    """
    if not hasattr(os, "sched_setaffinity"):
        raise InputError("cores: this system cannot bind a process to some of its cores; leave it out")
    available = sorted(os.sched_getaffinity(0))
    if not 1 <= count <= len(available):
        raise InputError(f"cores: this process may use 1 to {len(available)}, got {count}")
    os.sched_setaffinity(0, available[:count])


class Experiment:
    """Experiment of a module: options, results folder, tables and figures.

    Attributes:
        name: of its module.
        title: in the report.
        needs: kind of the rows without which there is nothing to show; empty for none.
    """

    def __init__(self, main: Callable[[Any, Start], str | None], title: str, needs: str) -> None:
        functools.update_wrapper(self, main)
        self.name, self.title, self.needs, self._main = name_of(main), title, needs, main

    def __call__(self, config: Any) -> list[Row]:
        """Run it and write rows, `NAME.md` and figures; the rows.

        Raises:
            InputError: bad options, or the folder cannot be written.
            SystemExit: after everything is written, if `main` returned what went wrong.
        """
        opened: list[Results] = []

        def start(capture: str = "") -> Results:
            out = config.out or Path("results") / self.name / capture
            opened.append(Results(out, self.name, config, resume=getattr(config, "resume", False)))
            return opened[-1]

        failure = self._main(config, start)
        (results,) = opened
        rows = results.finish()
        write_blocks(results.out, self.name, [*self.blocks(rows, results.out), provenance(rows)])
        if failure:
            print(f"{self.name}: {failure}", file=sys.stderr)
            sys.exit(1)
        return rows

    def blocks(self, rows: Sequence[Row], folder: Path) -> list[Block]:
        """Tables and figures from the rows, by the module's own `blocks`."""
        if self.needs and not of_kind(rows, self.needs):
            return [f"There is no {self.needs} yet."]
        return list(self._main.__globals__["blocks"](rows, folder))


def experiment(title: str, needs: str = "") -> Callable[[Callable[[Any, Start], str | None]], Experiment]:
    """Decorator of an experiment's `main(config, start)`; see `Experiment` for its arguments."""
    return functools.partial(Experiment, title=title, needs=needs)


def run(main: Callable[[Any], Any]) -> None:
    """Call `main` with the options of the command line, by its module's `Config`. Ends the process as `hyjax` does.

    Bad input: one line on stderr and exit status 2; interrupted: one line and 130.
    """
    function = inspect.unwrap(main)
    name, config_type = name_of(function), function.__globals__.get("Config")
    if config_type is None:
        sys.exit(f"{name}: has no options; give its file a dataclass Config")
    defer_interrupts()
    try:
        description = function.__globals__["__doc__"]
        main(tyro.cli(config_type, prog=f"python -m experiments.{name}", description=description))
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        going_on = "; the rows so far are kept, go on with --resume" if hasattr(config_type, "resume") else ""
        print(f"{name}: interrupted{going_on}", file=sys.stderr)
        exit_now(130)


def name_of(main: Callable[..., Any]) -> str:
    """Name of the module that a function is in, also where it runs as `__main__`."""
    return Path(inspect.getfile(main)).stem
