"""Time limit, progress bar and history of a tuning run."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any

from tqdm import tqdm

from hyjax.util.clock import Stopwatch


class RunMonitor:
    """Time limit, progress bar and history of a run.

    Args:
        limit: seconds that it may take; None for no limit.
        progress: show a bar on stderr.
    """

    def __init__(self, limit: float | None, progress: bool) -> None:
        self.clock, self.limit, self.progress = Stopwatch(), limit, progress
        self.history: list[dict[str, Any]] = []
        self.label, self.best, self.bar = "", math.inf, tqdm(disable=True)

    def expired(self) -> bool:
        return self.limit is not None and self.clock.seconds > self.limit

    @contextlib.contextmanager
    def watching(self, label: str) -> Iterator[None]:
        self.label, self.best = label, math.inf
        with tqdm(desc=f"tuning for {label}", unit="candidate", disable=not self.progress) as self.bar:
            yield

    def note(self, phase: str, loss: float) -> None:
        """Called by the search with everything it evaluates."""
        self.bar.update()
        if loss < self.best and phase != "relax":  # a relaxed point is no schedule yet
            self.best = loss
            entry = {"seconds": round(self.clock.seconds, 3), "budget": self.label, "phase": phase, "loss": loss}
            self.history.append(entry)
        self.bar.set_postfix_str(f"{phase}, best loss {self.best:.5f}", refresh=False)
