"""What is slow to make, made once for all threads that ask, and the last few of it kept."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """A function of a number that remembers its last results.

    Threads that ask for the same number wait for one of them; for different ones they work side by side.

    Args:
        make: the function; what it raises reaches everyone who waits and is not remembered.
        kept: how many results.
    """

    def __init__(self, make: Callable[[int], T], kept: int) -> None:
        self._make, self._kept = make, kept
        self._made: OrderedDict[int, Future[T]] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, number: int) -> T:
        with self._lock:
            future = self._made.get(number)
            mine = future is None
            if future is None:
                future = self._made[number] = Future()
            self._made.move_to_end(number)
            old = [key for key, made in self._made.items() if made.done()]
            for key in old[: max(0, len(self._made) - self._kept)]:
                del self._made[key]
        if mine:
            try:
                future.set_result(self._make(number))  # outside the lock
            except BaseException as error:
                with self._lock:
                    if self._made.get(number) is future:
                        del self._made[number]
                future.set_exception(error)
        return future.result()
