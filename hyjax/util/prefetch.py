"""Threads that prefetch and write while the device works.

Threads do, since reading, encoding, the rasteriser and XLA let go of Python while they run.
"""

import collections
import contextlib
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

DEPTH = 2
"""Results that wait to be used: enough to even out slow and fast ones, few enough for memory."""


def prefetch(
    function: Callable[[Item], Result], items: Iterable[Item], depth: int = DEPTH, threads: int = 1
) -> Generator[Result, None, None]:
    """`map(function, items)`, with up to `depth` results made ahead by other threads, in order.

    What `function` raises is raised here, in its turn. Nothing further is begun once the generator is closed.
    """
    pool = ThreadPoolExecutor(threads, thread_name_prefix="prefetch")
    waiting: collections.deque[Future[Result]] = collections.deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > depth:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def background_writer(depth: int = DEPTH, threads: int = 1) -> Iterator[Callable[[Callable[[], object]], None]]:
    """A function that has calls done by other threads; at the end of the context all are.

    They are begun in order. It waits while more than `depth` calls are still to be done. What a call raises is
    raised by one of the next ones, or at the end; calls after it are not done. If the body raises an exception,
    what it has asked for is still done; if it is interrupted, only what has begun.
    """
    pool = ThreadPoolExecutor(threads, thread_name_prefix="background-writer")
    waiting: collections.deque[Future[object]] = collections.deque()
    failed = threading.Event()

    def unless_failed(call: Callable[[], object]) -> None:
        if not failed.is_set():
            try:
                call()
            except BaseException:
                failed.set()
                raise

    def later(call: Callable[[], object]) -> None:
        waiting.append(pool.submit(unless_failed, call))
        while waiting and (len(waiting) > depth or waiting[0].done()):
            waiting.popleft().result()

    interrupted = False
    try:
        yield later
        while waiting:
            waiting.popleft().result()
    except BaseException as error:
        interrupted = not isinstance(error, Exception)
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=interrupted)
