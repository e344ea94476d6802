"""Tasks of a sweep, keyed by their content."""

import dataclasses
import functools
import json
from typing import Any

from hyjax.util.files import digest


@dataclasses.dataclass(frozen=True)
class Task:
    """Task: the payload of a function.

    >>> Task({"seed": 0, "size": 64}).key == Task({"size": 64, "seed": 0}).key
    True

    Attributes:
        kind: of its row; the same payload makes another task of another kind.
    """

    payload: dict[str, Any]
    kind: str = "result"

    @functools.cached_property
    def key(self) -> str:
        """Digest of the content."""
        return digest([self.kind, json.dumps(self.payload, sort_keys=True, separators=(",", ":"))])
