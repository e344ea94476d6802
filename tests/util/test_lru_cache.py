"""The cache of slow results that threads share."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from hyjax.util.lru_cache import LruCache


def test_one_key_is_computed_once_and_others_at_the_same_time() -> None:
    made: list[int] = []
    together = threading.Barrier(2, timeout=30)  # breaks unless 0 and 1 are computed side by side

    def make(number: int) -> int:
        together.wait()
        made.append(number)
        return number * number

    cache = LruCache(4)
    with ThreadPoolExecutor(8) as threads:
        numbers = [0, 0, 0, 1, 1, 1]
        assert list(threads.map(lambda n: cache(n, lambda: make(n)), numbers)) == [0, 0, 0, 1, 1, 1]
    assert sorted(made) == [0, 1]


def test_the_least_recently_used_goes_first() -> None:
    made: list[int] = []
    cache = LruCache(2)
    for number in (0, 1, 0, 2, 0, 1):
        assert cache(number, lambda number=number: made.append(number) or number) == number  # type: ignore[misc]
    assert made == [0, 1, 2, 1]
    assert 0 in cache and 1 in cache and 2 not in cache


def test_sizes_are_summed_and_a_result_that_is_too_large_is_kept_alone() -> None:
    cache = LruCache(10.0, size=len)
    for word in ("abc", "defg", "hij"):
        cache(word, lambda word=word: word)  # type: ignore[misc]
    assert all(word in cache for word in ("abc", "defg", "hij"))
    cache("k", lambda: "k")
    assert "abc" not in cache and "defg" in cache
    assert cache("long", lambda: "x" * 20) == "x" * 20
    assert "long" in cache and "k" not in cache


def test_a_result_that_is_being_computed_is_not_computed_again() -> None:
    """Not even when another one has taken its place meanwhile."""
    made: list[int] = []
    begun, go_on = threading.Event(), threading.Event()

    def make(number: int) -> int:
        made.append(number)
        if number == 0:
            begun.set()
            assert go_on.wait(30)
        return number

    cache = LruCache(1)
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(cache, 0, lambda: make(0))
        assert begun.wait(30)
        assert cache(1, lambda: make(1)) == 1
        second = threads.submit(cache, 0, lambda: make(0))
        go_on.set()
        assert first.result() == second.result() == 0
    assert made == [0, 1]


def test_a_failure_is_raised_and_not_remembered() -> None:
    answers = iter([ValueError("once"), 5])

    def make() -> int:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    cache = LruCache(2)
    with pytest.raises(ValueError, match="once"):
        cache(7, make)
    assert cache(7, make) == 5


def test_a_failure_in_one_thread_does_not_reach_another_that_waits() -> None:
    begun, go_on = threading.Event(), threading.Event()

    def fail() -> int:
        begun.set()
        assert go_on.wait(30)
        raise ValueError("cancelled")

    cache = LruCache(2)
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(cache, 0, fail)
        assert begun.wait(30)
        second = threads.submit(cache, 0, lambda: 3)
        go_on.set()
        assert second.result(30) == 3
        with pytest.raises(ValueError, match="cancelled"):
            first.result()
