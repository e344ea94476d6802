"""Results shared among threads."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from hyjax.recent import Recent


def test_one_number_is_made_once_and_others_at_the_same_time() -> None:
    made: list[int] = []
    together = threading.Barrier(2, timeout=30)  # breaks unless 0 and 1 are made side by side

    def make(number: int) -> int:
        together.wait()
        made.append(number)
        return number * number

    recent = Recent(make, 4)
    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(recent, [0, 0, 0, 1, 1, 1])) == [0, 0, 0, 1, 1, 1]
    assert sorted(made) == [0, 1]


def test_the_oldest_is_forgotten() -> None:
    made: list[int] = []
    recent = Recent(lambda number: made.append(number) or number, 2)
    for number in (0, 1, 0, 2, 0, 1):
        assert recent(number) == number
    assert made == [0, 1, 2, 1]


def test_what_is_being_made_is_not_forgotten() -> None:
    made: list[int] = []
    begun, go_on = threading.Event(), threading.Event()

    def make(number: int) -> int:
        made.append(number)
        if number == 0:
            begun.set()
            assert go_on.wait(30)
        return number

    recent = Recent(make, 1)
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(recent, 0)
        assert begun.wait(30)
        assert recent(1) == 1
        second = threads.submit(recent, 0)
        go_on.set()
        assert first.result() == second.result() == 0
    assert made == [0, 1]


def test_a_failure_is_told_and_not_remembered() -> None:
    answers = iter([ValueError("once"), 5])

    def make(_: int) -> int:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    recent = Recent(make, 2)
    with pytest.raises(ValueError, match="once"):
        recent(7)
    assert recent(7) == 5
