"""What was made last and may be wanted again, up to so much memory."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import jax

from hyjax.data.capture import Frame

T = TypeVar("T")


def mebibytes(made: object) -> float:
    """What arrays, or the picture of a frame, take in memory."""
    pixels = made.image if isinstance(made, Frame) else made
    return sum(getattr(leaf, "nbytes", 0) for leaf in jax.tree.leaves(pixels)) / 2**20


class Kept:
    """What was made last, up to a sum of weights: of what it takes in memory, unless `weigh` says otherwise."""

    def __init__(self, most: float, weigh: Callable[[object], float] = mebibytes) -> None:
        self._most, self._weigh = most, weigh
        self._made: OrderedDict[Hashable, Any] = OrderedDict()
        self._size = 0.0
        self._lock = threading.Lock()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._made

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        with self._lock:
            if key not in self._made:
                self._made[key] = made
                self._size += self._weigh(made)
            while self._size > self._most and len(self._made) > 1:
                _, old = self._made.popitem(last=False)
                self._size -= self._weigh(old)
        return made
