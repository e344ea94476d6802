"""Work of other threads: its order, its errors, its end."""

import threading
import time

import pytest

from hyjax.util.prefetch import background_writer, prefetch


def test_ahead_keeps_the_order_and_works_elsewhere() -> None:
    threads = set()

    def square(x: int) -> int:
        threads.add(threading.current_thread())
        return x * x

    assert list(prefetch(square, range(10))) == [x * x for x in range(10)]
    assert len(threads) == 1 and threading.current_thread() not in threads


def test_ahead_is_not_further_ahead_than_asked() -> None:
    begun = []
    results = prefetch(begun.append, range(100), depth=2)
    next(results)
    results.close()
    assert len(begun) <= 3


def test_ahead_raises_in_turn() -> None:
    def fail_at_two(x: int) -> int:
        if x == 2:
            raise ValueError("two")
        return x

    results = prefetch(fail_at_two, range(5))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="two"):
        next(results)


def test_ahead_of_nothing() -> None:
    assert list(prefetch(str, [])) == []


def test_behind_does_all_in_order() -> None:
    done: list[int] = []
    with background_writer() as later:
        for x in range(10):
            later(lambda x=x: (time.sleep(0.001), done.append(x)))
    assert done == list(range(10))


def test_behind_raises_what_a_call_raised_and_does_nothing_after_it() -> None:
    done: list[int] = []
    begin = threading.Event()

    def fail() -> None:
        begin.wait(5)
        raise ValueError("disk full")

    with pytest.raises(ValueError, match="disk full"), background_writer() as later:
        later(fail)
        later(lambda: done.append(1))
        begin.set()
        later(lambda: done.append(2))
    assert done == []


def test_behind_waits_when_too_much_is_asked_for() -> None:
    go, done = threading.Event(), []
    with background_writer(depth=1) as later:
        later(lambda: go.wait(5))
        assert not go.is_set()
        threading.Timer(0.1, go.set).start()
        later(lambda: done.append(1))  # one is before it
        assert go.is_set()
        later(lambda: done.append(2))
    assert done == [1, 2]


def test_ahead_works_while_a_result_is_used() -> None:
    begun = [threading.Event() for _ in range(3)]
    results = prefetch(lambda k: begun[k].set(), range(3), depth=1)
    next(results)
    assert begun[1].wait(5)
    results.close()


def test_behind_still_does_what_a_failing_body_asked_for() -> None:
    done: list[int] = []
    with pytest.raises(ValueError, match="unreadable"), background_writer() as later:
        later(lambda: (time.sleep(0.05), done.append(1)))
        later(lambda: done.append(2))
        raise ValueError("unreadable")
    assert done == [1, 2]


def test_behind_leaves_when_it_is_interrupted() -> None:
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt), background_writer() as later:
        for x in range(3):
            later(lambda x=x: (time.sleep(0.1), done.append(x)))
        raise KeyboardInterrupt
    assert len(done) <= 2
