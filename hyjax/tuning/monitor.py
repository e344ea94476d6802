"""Time limit and progress bar of a tuning run."""

import contextlib
import math
from collections.abc import Iterator

from tqdm import tqdm

from hyjax.util.clock import Stopwatch

SEARCH_SHARE = 0.6
"""Share of a time limit after which the search ends: what was found is then timed and judged."""
SECONDS_FORM = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt} of {total_fmt} s{postfix}"
"""Form of the bar where there is a time limit."""


class RunMonitor:
    """Time limit and progress bar of a run."""

    def __init__(self, limit: float | None, progress: bool) -> None:
        self.clock, self.limit, self.progress = Stopwatch(), limit, progress
        self.bar = tqdm(disable=True)

    def begin(self) -> None:
        """Count the time from now; else it counts from the monitor's making."""
        self.clock = Stopwatch()

    def expired(self) -> bool:
        """Whether the search has to end."""
        return self.limit is not None and self.clock.seconds > SEARCH_SHARE * self.limit

    def over(self) -> bool:
        """Whether the run has to end."""
        return self.limit is not None and self.clock.seconds > self.limit

    @contextlib.contextmanager
    def watching(self, parts: int) -> Iterator[None]:
        """One bar of the whole run, of about so many parts, or of the seconds that it may take."""
        total, form = (parts, None) if self.limit is None else (math.ceil(self.limit), SECONDS_FORM)
        with tqdm(desc="tuning", total=total, unit="part", disable=not self.progress, bar_format=form) as self.bar:
            yield
            self.bar.total = self.bar.n
            self.bar.refresh()

    def enter(self, phase: str) -> None:
        """Say what is done now."""
        self.bar.set_description_str(f"tuning: {phase}")

    def say(self, words: str) -> None:
        """Say how far a long part has come."""
        self.bar.set_postfix_str(words)

    def done(self) -> None:
        """Called after each part."""
        now = self.bar.n + 1 if self.limit is None else max(self.bar.n, round(self.clock.seconds))
        if self.bar.total is not None:
            self.bar.total = max(self.bar.total, now)
        self.bar.update(now - self.bar.n)

    def note(self, phase: str, best: float | None) -> None:
        """Called after each trial with the loss of the best so far over the default's; None where none fits."""
        found = "none within the budget yet" if best is None else f"best loss {best:.4f} of the default's"
        self.bar.set_postfix_str(f"{phase}, {found}", refresh=False)
        self.done()
