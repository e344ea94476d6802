"""The only timer of the package."""

import contextlib
import datetime
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import jax
import numpy as np
from tqdm import tqdm

T = TypeVar("T")

# Rounds that a time limit does not take away.
FEWEST_ROUNDS = 10


class Stopwatch:
    """Seconds since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._start


class StageClock:
    """Collects wall-clock times by stage, the first run of each stage apart from the rest.

    The first run of anything that JAX compiles contains the compilation, so it is never averaged with the others.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    @contextlib.contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a block. Asynchronous work must be waited for inside it."""
        start = time.perf_counter()
        yield
        self.seconds.setdefault(stage, []).append(time.perf_counter() - start)

    def follow(self, stages: Iterator[tuple[str, T]], until: str | None = None) -> T:
        """Last result of a generator of (stage, result), run to its end or to a stage; each is timed."""
        start = time.perf_counter()
        for stage, result in stages:
            jax.block_until_ready(result)
            now = time.perf_counter()
            self.seconds.setdefault(stage, []).append(now - start)
            start = now
            if stage == until:
                break
        return result

    def summary(self) -> dict[str, dict[str, float | int]]:
        """Milliseconds by stage: `first_ms` and, over the runs after it, `median_ms`, `p95_ms`, `count`."""
        return {stage: _statistics(values) for stage, values in self.seconds.items()}


def measure(function: Callable[..., Any], *arguments: Any, repeats: int = 20) -> dict[str, float | int]:
    """Time a function of arrays: the first call apart (it compiles), then `repeats` calls waited for one by one.

    Returns:
        As an entry of `StageClock.summary`.
    """
    return measure_each({"call": lambda: function(*arguments)}, repeats)["call"]


def measure_each(
    calls: Mapping[str, Callable[[], Any]],
    repeats: int,
    *,
    most_seconds: float | None = None,
    settled: bool = False,
    progress: bool = False,
) -> dict[str, dict[str, float | int]]:
    """Time several calls in turns, A B C A B C ..., so that a machine that slows down slows all of them alike.

    Every call runs once before anything else, which compiles it and is kept apart; each is waited for.

    Args:
        calls: what to time, by name.
        repeats: rounds after the first one.
        most_seconds: begin no further round after so long a time, if each call has run ten times by then.
        settled: make each call twice and time the second, so that none pays for what the one before left: threads
            that still spin, caches and memory full of other things.
        progress: show a bar on stderr.

    Returns:
        By name, in the order of `calls`, as `StageClock.summary`.
    """
    clock = StageClock()
    start = time.perf_counter()
    for count in tqdm(range(repeats + 1), "timing", unit="round", leave=False, disable=not progress):
        if most_seconds is not None and count > FEWEST_ROUNDS and time.perf_counter() - start > most_seconds:
            break
        for name, call in calls.items():
            if settled and count:
                jax.block_until_ready(call())
            with clock(name):
                jax.block_until_ready(call())
    return clock.summary()


def timestamp() -> str:
    """Now, in UTC, to the second, as ISO 8601 writes it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _statistics(seconds: list[float]) -> dict[str, float | int]:
    first, rest = seconds[0] * 1e3, np.array(seconds[1:]) * 1e3
    result: dict[str, float | int] = {"first_ms": round(first, 3), "count": len(rest)}
    if len(rest):
        result |= {
            "median_ms": round(float(np.median(rest)), 3),
            "p95_ms": round(float(np.percentile(rest, 95)), 3),
        }
    return result
