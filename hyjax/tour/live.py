"""Live tour: frames that arrive join the capture, and renderer and viewers follow the surface that they renew.

While the surface changes, shadows are coarse, as while something is dragged; they become fine when it rests. The
photo's own light stays in the pictures, as its estimate takes longer than a surface lasts.
"""

import dataclasses
from collections.abc import Generator
from typing import Any, get_args

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from hyjax.data.capture import Capture, Frame
from hyjax.live.scene import LiveScene
from hyjax.scene.surfaces import SURFACE_ERROR
from hyjax.tour.editable_scene import EditableScene
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import LampKind, TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

MOST_KEPT_FRAMES = 240
"""Frames that can be gone back to; when there are more, every second one is forgotten."""


class LiveCapture(Capture):
    """Frames that have arrived, without their depth.

    Attributes:
        arrived: number of all frames that have arrived, with those that were forgotten.

    Args:
        up: unit vector against gravity.
    """

    name, fingerprint = "live", "live"

    def __init__(self, up: Float[np.ndarray, "3"], most: int = MOST_KEPT_FRAMES) -> None:
        self.up, self._most, self.arrived = up, most, 0
        self._frames: list[tuple[Any, Frame]] = []

    def append(self, frame: Frame) -> bool:
        """Add a frame; true if others were forgotten for it, so that frames have other numbers now."""
        self.arrived += 1
        small = to_bytes(frame.image)
        empty = np.broadcast_to(np.zeros((), np.float32), frame.image.shape)  # takes no memory
        entry = small, dataclasses.replace(frame, image=empty, depth=None, depth_intrinsics=None, confidence=None)
        full = len(self._frames) >= self._most
        self._frames = [*(self._frames[::2] if full else self._frames), entry]
        return full

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        small, frame = self._frames[index]
        return dataclasses.replace(frame, image=small.astype(np.float32) / np.float32(255.0))


class LiveRenderer(Renderer):
    """Renderer of frames that arrive, on a surface that changes; see `Renderer`."""

    live = True
    _exposed = 0

    def expose(self) -> None:
        """Expose plans for the surface as it is now, as often as twice as many frames have arrived.

        While no camera sees the surface, the exposure stays as it was.
        """
        assert isinstance(self.capture, LiveCapture)
        if self.capture.arrived < 2 * self._exposed:
            return
        try:
            super().expose()
        except InputError:
            if not self._exposed:
                raise
        else:
            self._exposed = self.capture.arrived

    def _editable(self) -> EditableScene:
        assert isinstance(self.place, LiveScene)
        surface = self.place.surface
        assert surface is not None
        return EditableScene(
            surface.caster,
            self.up,
            self.folder,
            None,
            SURFACE_ERROR,
            revision=surface.revision,
            bounds=surface.bounds,
        )

    def warm_up(self, plan: TourPlan, viewpoint: Viewpoint) -> Generator[None]:
        """Compile the lamps, with coarse shadows: fine ones would be out of date at once."""
        origin = self.camera(viewpoint.frame).origin
        for kind in get_args(LampKind):
            self.render(replace(plan, lamps=(place_lamp(kind, origin, self.up),)), viewpoint, draft=True)
            yield
