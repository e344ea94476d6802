"""What every experiment's command line does alike."""

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import tyro

from hyjax.errors import InputError
from hyjax.interrupts import keep_interrupts, leave

Config = TypeVar("Config")


def run(main: Callable[[Config], None], config_type: type[Config]) -> None:
    """Call `main` with the options of the command line. Ends the process as `hyjax` does.

    Bad input: one line on stderr and exit status 2; interrupted: one line and 130.
    """
    name = Path(inspect.getfile(main)).stem
    keep_interrupts()
    try:
        main(tyro.cli(config_type, prog=f"python -m experiments.{name}", description=main.__globals__["__doc__"]))
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        going_on = "; the rows so far are kept, go on with --resume" if hasattr(config_type, "resume") else ""
        print(f"{name}: interrupted{going_on}", file=sys.stderr)
        leave(130)
