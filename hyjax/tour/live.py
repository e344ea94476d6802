"""Live tour: frames that arrive join the capture, and renderer and viewers follow the surface that they renew.

While the surface changes, shadows are coarse, as while something is dragged; they become fine when it rests. The
photo's own light stays in the pictures, as its estimate takes longer than a surface lasts.
"""

import dataclasses
from collections.abc import Callable, Generator, Hashable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.geometry.raycast import RayCaster
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.light.kinds import Light
from hyjax.light.setup import geometry_key
from hyjax.light.shadow_map import ShadowMap
from hyjax.live.shadow import LiveShadowMaps, LiveSurface
from hyjax.scene.occluders import SLACK
from hyjax.tour.editable_scene import AS_SCANNED, EditableScene, SceneParts
from hyjax.tour.layers import DRAFT, DRAFT_VIEWS, LayerCache, Quality, mebibytes, without_radius
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import LampKind, TourPlan
from hyjax.tour.renderer import FRAMES_MIB, Renderer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.lru_cache import LruCache

MOST_KEPT = 240
"""Frames that can be gone back to; when there are more, every second one is forgotten."""


class LiveCapture(Capture):
    """Frames that have arrived, without their depth.

    Args:
        up: unit vector against gravity.
        most: see `MOST_KEPT`.
    """

    name, fingerprint = "live", "live"

    def __init__(self, up: Float[np.ndarray, "3"], most: int = MOST_KEPT) -> None:
        self.up, self._most = up, most
        self._frames: list[tuple[Any, Frame]] = []

    def append(self, frame: Frame) -> bool:
        """Add a frame; true if others were forgotten for it, so that frames have other numbers now."""
        small = np.round(np.clip(frame.image, 0.0, 1.0) * 255.0).astype(np.uint8)
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


class LiveEditableScene(EditableScene):
    """Surface at one moment, whose parts have its revision in their keys: nothing cached of another is taken."""

    def __init__(self, surface: LiveSurface, up: Float[np.ndarray, "3"], folder: Path) -> None:
        super().__init__(surface.caster, up, folder, None, SLACK)
        self.revision = surface.revision

    def apply(self, plan: TourPlan) -> SceneParts:
        """See `EditableScene`."""
        parts = super().apply(plan)
        return dataclasses.replace(parts, keys=tuple((key, self.revision) for key in parts.keys))


class LiveLayers(LayerCache):
    """Layers whose shadow maps are drawn again with the surface, as long as no furniture has been moved.

    Attributes:
        surface: as it is now.
    """

    def __init__(self, surface: LiveSurface) -> None:
        super().__init__()
        self.surface = surface
        self._live = LiveShadowMaps(SLACK)
        self._fine: dict[Hashable, int] = {}

    def has_maps(self, light: Light, parts: SceneParts) -> bool:
        """See `LayerCache`."""
        if not _whole(parts):
            return super().has_maps(light, parts)
        return light.UNIFORM or self._fine.get(geometry_key(light)) == self.surface.revision

    def _shadow_map(
        self, light: Light, parts: SceneParts, quality: Quality, cancelled: Callable[[], bool]
    ) -> ShadowMap | None:
        if not _whole(parts):
            return super()._shadow_map(light, parts, quality, cancelled)
        geometry, unit, surface = geometry_key(light), light.normalized(), self.surface
        if quality == "draft":
            return self._live((geometry, quality), without_radius(unit), surface, DRAFT, DRAFT_VIEWS)
        made = self._live((geometry, quality), unit, surface)
        self._fine = {**dict(list(self._fine.items())[-64:]), geometry: surface.revision}
        return made


class LiveRenderer(Renderer):
    """Renderer of frames that arrive, on a surface that changes.

    Args:
        capture: with a frame at least.
        surface: as it is at the start.
        size: (height, width) that is worked at; None as the frames come.
        guide, folder: see `Renderer`.
    """

    live = True

    def __init__(
        self,
        capture: LiveCapture,
        surface: LiveSurface,
        *,
        size: tuple[int, int] | None = None,
        guide: FrameGuide = RGB,
        folder: Path = Path(),
    ) -> None:
        source: Any = SimpleNamespace(
            capture=capture,
            caster=surface.caster,
            occluders=surface.caster,
            slack=SLACK,
            mesh=surface.caster.mesh,
            frame=lambda index: fit(capture[index], size),
        )
        super().__init__(source, guide=guide, folder=folder, keep_photo_light=True)
        self._folder = folder
        self._layers: LayerCache = LiveLayers(surface)
        self.follow(surface)

    def follow(self, surface: LiveSurface) -> None:
        """Render on this surface from now on; a picture at work is finished on the one before."""
        caster: RayCaster = surface.caster
        scene = LiveEditableScene(surface, self.up, self._folder)
        assert isinstance(self._layers, LiveLayers)
        self._layers.surface, self.scene = surface, scene
        a, b, c = caster.mesh.extents
        self.surface_area = 2.0 * float(a * b + b * c + c * a)

    def warm_up(self, plan: TourPlan, viewpoint: Viewpoint) -> Generator[None]:
        """Compile the lamps, with coarse shadows: fine ones would be out of date at once."""
        origin = self.camera(viewpoint.frame).origin
        for kind in get_args(LampKind):
            self.render(replace(plan, lamps=(place_lamp(kind, origin, self.up),)), viewpoint, draft=True)
            yield

    def forget_frames(self) -> None:
        """Forget all that is known of frames by their numbers, which are other ones now."""
        assert isinstance(self._layers, LiveLayers)
        self._frames, self._cameras = LruCache(FRAMES_MIB, mebibytes), {}
        self._layers = LiveLayers(self._layers.surface)


def _whole(parts: SceneParts) -> bool:
    """Whether nothing was taken out of the room or brought in."""
    return len(parts.keys) == 1 and parts.keys[0][0] == AS_SCANNED  # type: ignore[index]
