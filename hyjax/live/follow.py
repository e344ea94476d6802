"""Follower: threads that read frames as they arrive and keep a live scene up to date, while others look at it."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable

from hyjax.data.capture import Frame
from hyjax.live.scene import LiveScene

MOST_WAITING = 2
"""Frames that may wait to be taken into the volume: of thirty a second ten are enough for the surface."""
_log = logging.getLogger(__name__)


class Follower:
    """One thread reads frames, another takes them into a scene and renews its surface, as often as it can.

    Attributes:
        newest: the last frame that was taken; None before the first.
        frames, updates, dropped: how many were taken, how often the surface was renewed, and how many frames were
            dropped because they came faster than they could be taken.

    Args:
        scene: that the frames join; nobody else may call its `add` and `update`.
        frames: in order of time; may block until the next is there.
        on_update: called on the second thread after each renewal, with the newest frame.
        drop: whether the oldest waiting frame is dropped when they come too fast; else the reader waits.
    """

    def __init__(
        self,
        scene: LiveScene,
        frames: Iterable[Frame],
        on_update: Callable[[Frame], None] = lambda frame: None,
        *,
        drop: bool = True,
    ) -> None:
        self.scene = scene
        self.newest: Frame | None = None
        self.frames = self.updates = self.dropped = 0
        self._source, self._on_update, self._drop = frames, on_update, drop
        self._waiting: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._stopped = self._read = False
        self._threads = [
            threading.Thread(target=task, name=f"live {name}", daemon=True)
            for name, task in (("reader", self._reading), ("surface", self._following))
        ]

    def start(self) -> "Follower":
        """Start the threads; itself."""
        for thread in self._threads:
            thread.start()
        return self

    @property
    def done(self) -> bool:
        """Whether there are no more frames and all have been taken, or it was stopped."""
        return not self._threads[1].is_alive()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until it is `done`, or for so long; whether it is."""
        self._threads[1].join(seconds)
        return self.done

    def stop(self) -> None:
        """End when the frame at work is done. A reader that waits for a frame ends with the process."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        if self._threads[1].is_alive():
            self._threads[1].join()

    def _reading(self) -> None:
        try:
            for frame in self._source:
                with self._changed:
                    while not self._drop and len(self._waiting) >= MOST_WAITING and not self._stopped:
                        self._changed.wait()
                    if self._stopped:
                        return
                    if len(self._waiting) >= MOST_WAITING:
                        self._waiting.popleft()
                        self.dropped += 1
                    self._waiting.append(frame)
                    self._changed.notify_all()
        except Exception:
            _log.exception("live: no more frames are read")
        finally:
            with self._changed:
                self._read = True
                self._changed.notify_all()

    def _following(self) -> None:
        while frames := self._next():
            try:
                taken = [frame for frame in frames if self.scene.add(frame)]
                self.frames += len(taken)
                self.newest = frames[-1]  # a frame without depth is shown all the same
                if taken:
                    self.scene.update()
                    self.updates += 1
                self._on_update(frames[-1])
            except Exception:
                _log.exception("live: frames up to %s could not be used", frames[-1].name)

    def _next(self) -> list[Frame]:
        with self._changed:
            while not self._waiting and not self._read and not self._stopped:
                self._changed.wait()
            frames = [] if self._stopped else list(self._waiting)
            self._waiting.clear()
            self._changed.notify_all()
            return frames
