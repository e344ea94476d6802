"""Times of calls in turns."""

from collections.abc import Callable, Mapping
from typing import Any

from hyjax.tuning.calibration import MOST_SECONDS
from hyjax.tuning.cost_model import Milliseconds
from hyjax.util.clock import measure_each
from hyjax.util.errors import InputError


def check_repeats(repeats: int) -> None:
    """Raise `InputError` unless something is to be timed at least once."""
    if repeats < 1:
        raise InputError(f"repeats: must be at least 1, got {repeats}")


def time_calls(
    calls: Mapping[str, Callable[[], Any]],
    repeats: int,
    *,
    most_seconds: float | None = MOST_SECONDS,
    progress: bool = False,
) -> dict[str, Milliseconds]:
    """Time calls in turns, by name, see `measure_each`."""
    check_repeats(repeats)
    summary = measure_each(calls, repeats, most_seconds=most_seconds, progress=progress)
    return {name: Milliseconds(entry["median_ms"], entry["p95_ms"]) for name, entry in summary.items()}
