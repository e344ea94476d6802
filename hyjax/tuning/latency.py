"""The only timer of the package."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import jax
import numpy as np

T = TypeVar("T")


class StageClock:
    """Collects wall-clock times by stage, the first run of each stage apart from the rest.

    The first run of anything that JAX compiles contains the compilation, so it is never averaged with the others.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    @contextlib.contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a block. What runs asynchronously must be waited for inside it."""
        start = time.perf_counter()
        yield
        self.seconds.setdefault(stage, []).append(time.perf_counter() - start)

    def follow(self, stages: Iterator[tuple[str, T]]) -> T:
        """Run a generator of (stage, result) to its end, time each stage, and return the last result."""
        start = time.perf_counter()
        for stage, result in stages:
            jax.block_until_ready(result)
            now = time.perf_counter()
            self.seconds.setdefault(stage, []).append(now - start)
            start = now
        return result

    def summary(self) -> dict[str, dict[str, float | int]]:
        """Milliseconds by stage: `first_ms` and, over the runs after it, `median_ms`, `p95_ms`, `count`."""
        return {stage: _statistics(values) for stage, values in self.seconds.items()}


def measure(function: Callable[..., Any], *arguments: Any, repeats: int = 20) -> dict[str, float | int]:
    """Time a function of arrays: the first call apart (it compiles), then `repeats` calls waited for one by one.

    Returns:
        As an entry of `StageClock.summary`.
    """
    clock = StageClock()
    for _ in range(repeats + 1):
        with clock("call"):
            jax.block_until_ready(function(*arguments))
    return clock.summary()["call"]


def _statistics(seconds: list[float]) -> dict[str, float | int]:
    first, rest = seconds[0] * 1e3, np.array(seconds[1:]) * 1e3
    result: dict[str, float | int] = {"first_ms": round(first, 3), "count": len(rest)}
    if len(rest):
        result |= {
            "median_ms": round(float(np.median(rest)), 3),
            "p95_ms": round(float(np.percentile(rest, 95)), 3),
        }
    return result
