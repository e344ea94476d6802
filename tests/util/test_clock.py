"""The timer: the first run apart, everything waited for."""

import datetime
import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.util import clock as latency
from hyjax.util.clock import StageClock, Stopwatch, measure, measure_each, timestamp


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that a test sets: `perf_counter` returns ticks[0]."""
    now = [0.0]
    monkeypatch.setattr(latency.time, "perf_counter", lambda: now[0])
    return now


def test_a_stopwatch_counts_from_when_it_was_made(ticks: list[float]) -> None:
    ticks[0] = 100.0
    watch = Stopwatch()
    assert watch.seconds == 0.0
    ticks[0] += 4.0
    assert watch.seconds == 4.0
    assert watch.seconds == 4.0  # looking does not stop it


def test_first_run_is_apart_from_the_rest(ticks: list[float]) -> None:
    clock = StageClock()
    for duration in (9.0, 1.0, 2.0, 6.0):
        with clock("a"):
            ticks[0] += duration
        ticks[0] += 100.0  # between the blocks, not to be counted
    assert clock.summary() == {"a": {"first_ms": 9000.0, "count": 3, "median_ms": 2000.0, "p95_ms": 5600.0}}


def test_a_single_run_has_no_median(ticks: list[float]) -> None:
    clock = StageClock()
    with clock("once"):
        ticks[0] += 0.25
    assert clock.summary() == {"once": {"first_ms": 250.0, "count": 0}}


def test_stages_keep_their_order_and_stay_apart(ticks: list[float]) -> None:
    clock = StageClock()
    for stage, duration in (("b", 1.0), ("a", 2.0), ("b", 3.0)):
        with clock(stage):
            ticks[0] += duration
    summary = clock.summary()
    assert list(summary) == ["b", "a"]
    assert summary["b"]["median_ms"] == 3000.0 and summary["a"]["first_ms"] == 2000.0


def test_a_failed_block_is_not_recorded() -> None:
    clock = StageClock()
    with pytest.raises(RuntimeError), clock("a"):
        raise RuntimeError
    assert clock.summary() == {}


def test_follow_gives_each_stage_its_own_time_and_returns_the_last(ticks: list[float]) -> None:
    def stages() -> Iterator[tuple[str, int]]:
        ticks[0] += 1.0
        yield "one", 1
        ticks[0] += 2.0
        yield "two", 2

    clock = StageClock()
    assert clock.follow(stages()) == 2
    assert clock.summary() == {"one": {"first_ms": 1000.0, "count": 0}, "two": {"first_ms": 2000.0, "count": 0}}


def slow(x: jax.Array) -> jax.Array:
    """Dispatched at once, done 30 ms later at the earliest."""

    def wait(v: np.ndarray) -> np.ndarray:
        time.sleep(0.03)
        return v

    return jax.pure_callback(wait, jax.ShapeDtypeStruct(x.shape, x.dtype), x)


def test_follow_waits_for_what_runs_asynchronously() -> None:
    compiled = jax.jit(slow)
    clock = StageClock()
    for _ in range(2):
        clock.follow(("slow", compiled(x)) for x in [jnp.ones(3)])
    assert clock.summary()["slow"]["median_ms"] >= 29


def test_measure_calls_and_counts() -> None:
    calls = []

    def function(a: jax.Array, b: jax.Array) -> jax.Array:
        calls.append(None)
        return a + b

    result = measure(function, jnp.ones(3), jnp.ones(3), repeats=4)
    assert len(calls) == 5
    assert set(result) == {"first_ms", "count", "median_ms", "p95_ms"}
    assert result["count"] == 4


def test_measure_waits_and_keeps_compilation_out_of_the_median() -> None:
    def traced_slowly(x: jax.Array) -> jax.Array:
        time.sleep(0.3)
        return slow(x)

    result = measure(jax.jit(traced_slowly), jnp.ones(3), repeats=3)
    assert result["first_ms"] >= 300
    assert 29 <= result["median_ms"] < 300


def test_measure_each_takes_turns_and_keeps_the_first_round_apart(ticks: list[float]) -> None:
    order = []

    def call(name: str, seconds: float) -> None:
        order.append(name)
        ticks[0] += seconds * (100 if len(order) <= 2 else 1)  # the first round compiles

    summary = measure_each({"b": lambda: call("b", 1.0), "a": lambda: call("a", 2.0)}, 3)
    assert "".join(order) == "ba" * 4
    assert list(summary) == ["b", "a"]
    assert summary["b"] == {"first_ms": 100e3, "count": 3, "median_ms": 1000.0, "p95_ms": 1000.0}
    assert summary["a"] == {"first_ms": 200e3, "count": 3, "median_ms": 2000.0, "p95_ms": 2000.0}


def test_measure_each_spreads_a_slow_spell_over_all(ticks: list[float]) -> None:
    """A machine ten times slower in a fifth of the rounds moves nobody's median."""
    calls = [0]

    def call() -> None:
        ticks[0] += 10.0 if calls[0] // 3 in (4, 5) else 1.0
        calls[0] += 1

    summary = measure_each(dict.fromkeys("abc", call), 10)
    assert [entry["median_ms"] for entry in summary.values()] == [1000.0] * 3


def test_measure_each_ends_early_but_not_before_ten_rounds(ticks: list[float]) -> None:
    def call() -> None:
        ticks[0] += 1.0

    assert measure_each({"a": call}, 50, most_seconds=3.0)["a"]["count"] == 10
    assert measure_each({"a": call}, 50, most_seconds=30.0)["a"]["count"] == 30
    assert measure_each({"a": call}, 5, most_seconds=0.0)["a"]["count"] == 5


def test_measure_each_waits() -> None:
    compiled = jax.jit(slow)
    assert measure_each({"slow": lambda: compiled(jnp.ones(3))}, 2)["slow"]["median_ms"] >= 29


def test_timestamp_says_its_time_zone() -> None:
    assert datetime.datetime.fromisoformat(timestamp()).utcoffset() == datetime.timedelta(0)
