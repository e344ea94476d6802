"""Frames that arrive for a live tour: from their source into the surface, the capture and the renderer."""

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from hyjax.configuration import Configuration
from hyjax.data.capture import Frame
from hyjax.data.recording import mean_up
from hyjax.live.follow import Follower
from hyjax.live.scene import LiveScene
from hyjax.live.source import known_up, live_frames
from hyjax.tour.live import LiveCapture, LiveRenderer
from hyjax.util.errors import InputError

FIRST_FRAMES = 15
"""That are waited for before the page is served, if they come within `FIRST_SECONDS`."""
FIRST_SECONDS = 5.0


class Arriving:
    """Frames on their way into a tour.

    Attributes:
        on_frame: called after a frame has renewed the surface and joined the capture, with whether others were
            forgotten for it.

    Args:
        size: (height, width) that is worked at; None as they come, but no wider than `widest`.
        widest: pixels.
    """

    def __init__(
        self, scene: LiveScene, source: str | Iterable[Frame], *, size: tuple[int, int] | None, widest: int
    ) -> None:
        self.on_frame: Callable[[bool], object] = lambda forgotten: None
        self._scene, self._size, self._widest = scene, size, widest
        self._up = known_up(source) if isinstance(source, str) else None
        self._early: list[Frame] = []
        self._renderer: LiveRenderer | None = None
        frames = live_frames(source) if isinstance(source, str) else source
        # A folder keeps what it has; a stream does not wait.
        self._follower = Follower(scene, frames, self._arrived, drop=source in ("-", "record3d")).start()

    def first_renderer(self, folder: Path, configuration: Configuration) -> LiveRenderer:
        """Renderer of the first frames, once they have a surface; arguments as of `Renderer`."""
        begun = None
        while True:
            done = self._follower.wait(0.02)
            if self._scene.surface is not None:
                begun = time.monotonic() if begun is None else begun
                if done or (
                    len(self._early)
                    and (self._follower.frames >= FIRST_FRAMES or time.monotonic() - begun > FIRST_SECONDS)
                ):
                    break
            elif done:
                reasons = "; ".join(f"{count} frames: {reason}" for reason, count in self._scene.skipped.items())
                raise InputError(f"live: the frames ended before there was a surface {reasons}".rstrip())
        early = list(self._early)
        up = mean_up([frame.camera.pose for frame in early], "live") if self._up is None else self._up
        capture = LiveCapture(up)
        for frame in early:  # one alone may look beside the surface
            capture.append(frame)
        height, width = early[-1].camera.intrinsics.shape
        self._scene.size = self._size
        if self._size is None and width > self._widest:
            self._scene.size = round(height * self._widest / width), self._widest
        self._renderer = LiveRenderer(self._scene, capture, folder=folder, configuration=configuration)
        return self._renderer

    def stop(self) -> None:
        """Take no more frames."""
        self._follower.stop()

    def _arrived(self, frame: Frame) -> None:
        renderer = self._renderer
        if renderer is None or self._scene.surface is None:
            self._early = [*self._early[-FIRST_FRAMES:], frame]
            return
        assert isinstance(renderer.capture, LiveCapture)
        renderer.follow()
        if forgotten := renderer.capture.append(frame):
            renderer.forget_frames()
        self.on_frame(forgotten)
