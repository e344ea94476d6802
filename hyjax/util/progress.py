"""Progress bars: of a step by itself, or one bar for all steps of a command."""

import contextlib
import threading
from collections.abc import Iterable, Iterator, Sized
from typing import Any, Generic, TypeVar

from tqdm import tqdm

T = TypeVar("T")
STEPS_FORMAT = "{desc} [{elapsed}]"
"""Form of a bar while the number of what comes in the end is not yet counted."""
START_SECONDS = 1.0
"""Least seconds before the first state of a bar that goes to a file: what is refused by then stands alone."""
_shared: "CommandBar | None" = None


class CommandBar:
    """Bar of a command: what is being done, and later how many of its frames are done.

    Args:
        unit: of what is counted in the end.
    """

    def __init__(self, description: str, unit: str) -> None:
        self._description, self._lock = description, threading.Lock()
        self._bar = tqdm(
            total=0, desc="starting", unit=unit, bar_format=STEPS_FORMAT, leave=False, delay=START_SECONDS
        )
        if self._bar.mininterval < 1:  # it is watched
            self._bar.delay = 0.0
            self._bar.refresh()
        self._steps: dict[int, str] = {}

    def show(self, step: object, text: str | None) -> None:
        """Show what a step is at, beside others that run at the same time; None where it has ended."""
        with self._lock:
            self._steps.pop(id(step), None)
            if text is not None:
                self._steps[id(step)] = text
            if self._steps:
                self._bar.set_description_str(", ".join(self._steps.values()), refresh=False)
                self._bar.update(0)
                if self._bar.mininterval < 1:  # it is watched
                    self._bar.refresh()

    def count(self, items: Iterable[T], total: int) -> Iterator[T]:
        """Items, counted from now on."""
        bar = self._bar
        bar.bar_format, bar.leave, bar.delay = None, True, 0.0
        bar.set_description(self._description, refresh=False)
        bar.reset(total)
        for item in items:
            yield item
            bar.update()

    def close(self) -> None:
        """End the bar."""
        self._bar.close()


@contextlib.contextmanager
def command_bar(description: str, unit: str, *, disable: bool) -> Iterator[CommandBar | None]:
    """One bar for the steps of the block, on any thread; None where it is disabled or there is one already."""
    global _shared
    if disable or _shared is not None:
        yield None
        return
    _shared = bar = CommandBar(description, unit)
    try:
        yield bar
    finally:
        _shared = None
        bar.close()


class StepBar(Generic[T]):
    """Bar of a step: a line of its own, or its text in the bar of the command.

    Arguments as of `tqdm`.
    """

    def __init__(
        self,
        iterable: Iterable[T] = (),
        desc: str = "",
        total: int | None = None,
        *,
        unit: str,
        initial: int = 0,
        disable: bool = False,
    ) -> None:
        total = len(iterable) if total is None and isinstance(iterable, Sized) else total
        self._items, self._desc, self._total, self._done = iterable, desc, total, initial
        self._command = None if disable else _shared
        hidden = disable or self._command is not None
        self._bar: Any = tqdm(total=total, desc=desc, unit=unit, initial=initial, disable=hidden)

    def update(self) -> None:
        """Count one more."""
        self._done += 1
        self._bar.update()
        self._show()

    def set_description(self, desc: str) -> None:
        """Name what comes now."""
        self._desc = desc
        self._bar.set_description(desc)
        self._show()

    def __iter__(self) -> Iterator[T]:
        with self:
            for item in self._items:
                yield item
                self.update()

    def __enter__(self) -> "StepBar[T]":
        self._show()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        if self._command is not None:
            self._command.show(self, None)

    def _show(self) -> None:
        if self._command is not None:
            counted = f" {self._done}" + ("" if self._total is None else f"/{self._total}")
            self._command.show(self, self._desc + counted)
