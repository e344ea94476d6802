"""Cache of slow results, shared among threads; the least recently used ones go first."""

import dataclasses
import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

import cachetools

T = TypeVar("T")


class LruCache:
    """Results by key.

    Threads that ask for the same key wait for one of them; for different keys they work side by side. A failure
    reaches the thread in which it happened; one that waited then tries by itself.

    Args:
        maxsize: sum of the sizes that is kept; a single larger result is kept alone.
        size: of a result; by default each counts 1.
    """

    def __init__(self, maxsize: float, size: Callable[[Any], float] = lambda result: 1) -> None:
        self._results = cachetools.LRUCache[Hashable, Any](maxsize, lambda result: min(size(result), maxsize))
        one_thread_a_key = cachetools.cached(
            self._results, key=lambda key, make: key, condition=threading.Condition()
        )
        self._get = one_thread_a_key(lambda key, make: make())

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result for a key, from the cache or by calling `make`."""
        return cast(T, self._get(key, make))

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results


@dataclasses.dataclass(frozen=True)
class CachePart:
    """Results of one kind in a cache that several kinds share."""

    cache: LruCache
    kind: str

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        return self.cache((self.kind, key), make)

    def __contains__(self, key: Hashable) -> bool:
        return (self.kind, key) in self.cache
