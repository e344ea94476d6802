"""Result of a conversion: files in memory, and a way to run them."""

import dataclasses
import sys
from collections.abc import Mapping

from hyjax.export.graph import Run


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


def say(text: str, *, quiet: bool) -> None:
    """Print a line of progress."""
    if not quiet:
        print(f"export: {text}", file=sys.stderr, flush=True)
