"""Result of a conversion: files in memory, and a way to run them."""

import dataclasses
import importlib
import sys
from collections.abc import Mapping
from types import ModuleType

from hyjax.export.graph import Run
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class Artifact:
    """Converted function.

    Attributes:
        files: contents by name; a slash makes a folder.
        run: calls the function in its own runtime; None where that does not run on this machine.
        unchecked: why not, in a clause.
    """

    files: Mapping[str, bytes]
    run: Run | None
    unchecked: str = ""

    @property
    def size(self) -> int:
        """Bytes of the file that a device needs: the first, or all in its folder."""
        names = list(self.files)
        folder = names[0].partition("/")[0]
        return sum(len(self.files[name]) for name in names if name.partition("/")[0] == folder)


def load(module: str, extra: str, *, besides: str = "") -> ModuleType:
    """An optional package's module.

    Args:
        module: its full name.
        extra: of hyjax, that brings it.
        besides: a command that is needed after that of the extra.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = (error.name or module).partition(".")[0]
        also = f", then: {besides}" if besides else ""
        raise InputError(
            f"export: needs the package {missing}; install it with: pip install '.[{extra}]'{also}"
        ) from None


def say(text: str, *, quiet: bool) -> None:
    """Print a line of progress."""
    if not quiet:
        print(f"export: {text}", file=sys.stderr, flush=True)
