"""Work of other threads: its order, its errors, its end."""

import threading
import time

import pytest

from hyjax.overlap import ahead, behind


def test_ahead_keeps_the_order_and_works_elsewhere() -> None:
    threads = set()

    def square(x: int) -> int:
        threads.add(threading.current_thread())
        return x * x

    assert list(ahead(square, range(10))) == [x * x for x in range(10)]
    assert len(threads) == 1 and threading.current_thread() not in threads


def test_ahead_is_not_further_ahead_than_asked() -> None:
    begun = []
    results = ahead(begun.append, range(100), depth=2)
    next(results)
    results.close()
    assert len(begun) <= 3


def test_ahead_raises_in_turn() -> None:
    def fail_at_two(x: int) -> int:
        if x == 2:
            raise ValueError("two")
        return x

    results = ahead(fail_at_two, range(5))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="two"):
        next(results)


def test_ahead_of_nothing() -> None:
    assert list(ahead(str, [])) == []


def test_behind_does_all_in_order() -> None:
    done: list[int] = []
    with behind() as later:
        for x in range(10):
            later(lambda x=x: (time.sleep(0.001), done.append(x)))
    assert done == list(range(10))


def test_behind_raises_what_a_call_raised_and_stops() -> None:
    done: list[int] = []

    def fail() -> None:
        raise ValueError("disk full")

    with pytest.raises(ValueError, match="disk full"), behind() as later:
        later(fail)
        for x in range(10):
            later(lambda x=x: done.append(x))
    assert len(done) < 10


def test_behind_leaves_when_the_body_fails() -> None:
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt), behind() as later:
        for x in range(3):
            later(lambda x=x: (time.sleep(0.05), done.append(x)))
        raise KeyboardInterrupt
    count = len(done)
    assert count <= 2
    time.sleep(0.1)
    assert len(done) == count
