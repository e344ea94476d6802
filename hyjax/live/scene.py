"""Live scene: frames join one by one, and its surface, shadows and relit pictures follow.

    scene = LiveScene()
    relighter = Relighter(scene, lights, "fast")
    for frame in frames:
        if scene.add(frame):
            scene.update()  # or a few times a second
        if scene.surface is not None:
            show(relighter.relit(frame).image)

What a finished capture has and this has not: the photo's own light stays in the pictures, no bounces are added, and
holes of the surface are not closed before it throws shadows; each of these takes longer than a frame lasts.
"""

import logging
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from hyjax.data.capture import Frame
from hyjax.data.frames import fit
from hyjax.geometry.camera import Camera, Intrinsics, check_pose
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.raycast import RayCaster
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.setup import LightSetup
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.live.caster import LiveCaster
from hyjax.live.mesh import LiveMesh
from hyjax.live.shadow import LiveShadowMaps, LiveSurface
from hyjax.live.volume import LiveVolume
from hyjax.scene.place import view_of
from hyjax.scene.settings import Occluders
from hyjax.util.errors import InputError

VOXEL = 0.04
"""Metres."""
MAX_DEPTH = 5.0
"""Metres beyond which readings are left out."""
DEPTH_WIDTH = 320
"""Columns of a depth map that are used, about: with voxels of 4 cm more of them add nothing."""
MOST_REGIONS = 16
"""Most regions that are meshed anew at once, the most changed first; 1.3 m each way with voxels of 4 cm."""
SHADOW_SCALE = 0.5
"""Resolution of shadow maps, relative to that of `hyjax relight`."""
BOUNDS_STEP = 1.0
"""Metres that the surface's bounds are rounded to."""
LINE_INTERVAL = 100
"""Frames that are skipped for one reason between two lines about it."""
_log = logging.getLogger(__name__)


class LiveScene:
    """Surface of a place that grows and changes with its frames, and the light on it.

    `add` and `update` belong to one thread; everything else may be called from any.

    Attributes:
        size: (height, width) that pictures are relit at; None as they come.
        surface: as of the last `update`; None before there is any.
        skipped: frames that were not used, by reason.
        times: seconds that the parts of the last `update` took.

    Args:
        voxel: edge in metres.
    """

    def __init__(self, *, voxel: float = VOXEL) -> None:
        self.volume = LiveVolume(voxel)
        self.pieces = LiveMesh(self.volume)
        self.size: tuple[int, int] | None = None
        self.surface: LiveSurface | None = None
        self.skipped: Counter[str] = Counter()
        self.times: dict[str, float] = {}
        self._maps, self._last = LiveShadowMaps(), -np.inf
        self._pool = ThreadPoolExecutor(thread_name_prefix="live volume")
        self._revision = 0

    # ---- frames come in ----

    def add(self, frame: Frame) -> bool:
        """Take a frame's depth into the volume; false if it was skipped, with a line that says why.

        Frames must come in order of time. One without depth is skipped here, and can be relit all the same.
        """
        reason = self._unusable(frame)
        if reason:
            self.skip(frame.name, reason)
            return False
        self._last = frame.time
        assert frame.depth is not None
        reading = thinned(DepthReading(frame.depth, frame.depth_camera, frame.confidence))
        try:
            self.volume.integrate(reading.depth, reading.camera, MAX_DEPTH, self._pool)
        except InputError as error:
            self.skip(frame.name, str(error))
            return False
        return True

    def skip(self, name: str, reason: str) -> None:
        """Count a frame that is not used, with a line for the first of each reason and every hundredth after it."""
        self.skipped[reason] += 1
        count = self.skipped[reason]
        if count == 1 or count % LINE_INTERVAL == 0:
            many = "" if count == 1 else f" ({count} so far)"
            _log.warning("live: frame %s skipped: %s%s", name, reason, many)

    def _unusable(self, frame: Frame) -> str:
        if frame.depth is None:
            return "it has no depth"
        if not np.isfinite(frame.time) or frame.time <= self._last:
            return "it does not come after the one before"
        try:
            check_pose(frame.camera.pose)
        except InputError as error:
            return str(error)
        if frame.depth.shape != frame.depth_camera.intrinsics.shape:
            return "its depth map is of another size than its intrinsics"
        return ""

    # ---- the surface follows ----

    def update(self) -> LiveSurface | None:
        """Renew mesh and caster where the volume has changed, the largest changes first; `surface` afterwards."""
        begun = time.perf_counter()
        _, changed = self.pieces.renew(MOST_REGIONS)
        meshed = time.perf_counter()
        if changed and self.pieces.pieces:
            self._revision += 1
            caster = LiveCaster(self.pieces.pieces)
            low, high = caster.bounds
            rounded = np.stack([np.floor(low / BOUNDS_STEP), np.ceil(high / BOUNDS_STEP)]) * BOUNDS_STEP
            self.surface = LiveSurface(caster, self._revision, rounded)
        self.times = {"mesh": meshed - begun, "caster": time.perf_counter() - meshed}
        return self.surface

    @property
    def mesh(self) -> trimesh.Trimesh:
        """Surface as a mesh."""
        return self._now().caster.mesh

    # ---- pictures are relit ----

    @property
    def revision(self) -> int | None:
        """Number of the surface as it is now; None before there is any."""
        return None if self.surface is None else self.surface.revision

    @property
    def knows_photo_light(self) -> bool:
        """Whether the light that the frames were taken under can be divided out: it stays in them."""
        return False

    @property
    def caster(self) -> RayCaster:
        """The surface."""
        return self._now().caster

    def frame(self, index: int | Frame) -> Frame:
        """Frame at the size that pictures are relit at."""
        if not isinstance(index, Frame):
            raise InputError(f"live: frames have no position, got {index}; give a frame")
        return fit(index, self.size)

    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface points seen by a camera; by single rays, if so."""
        return self.caster.gbuffer_by_rays(camera) if rays else self.caster.gbuffer(camera)

    def view(self, frame: Frame) -> View:
        """View of any frame, on the surface as it is now."""
        fitted = self.frame(frame)
        return view_of(fitted, self.gbuffer(fitted.camera))

    def lights(
        self, lights: LightSetup | Sequence[Light] | str | Path, *, at_photo_sources: bool = False
    ) -> LightSetup:
        """Light set-up; its name or file would need the whole room."""
        if isinstance(lights, str | Path):
            raise InputError(f"live: {lights}: set-ups are placed in a finished scan; give the lights themselves")
        return LightSetup.of(lights)

    def shadow_maps(
        self,
        lights: LightSetup | Sequence[Light],
        *,
        occluders: Occluders = "completed",
        scale: float = 1.0,
        most_views: int | None = None,
    ) -> tuple[ShadowMap | None, ...]:
        """Shadow maps of lights, drawn where the surface, which throws them, has changed since they were asked for.

        Arguments: see `Place`; the scale is relative to the scene's own.
        """
        surface, scale = self._now(), scale * SHADOW_SCALE
        return tuple(self._maps(light, surface, scale, most_views) for light in LightSetup.of(lights).lights)

    def surface_light(
        self, lights: LightSetup | Sequence[Light], *, shadows: bool = True, occluders: Occluders = "completed"
    ) -> SurfaceLight:
        """Not known of a surface that changes."""
        raise InputError("live: the photo's light is not known while the surface changes")

    def _now(self) -> LiveSurface:
        if self.surface is None:
            raise InputError("live: there is no surface yet; it comes with the first frames that have depth")
        return self.surface


def thinned(reading: DepthReading) -> DepthReading:
    """Every n-th pixel of a depth map that has more columns than are used; mixing depths would invent surfaces."""
    step = max(1, reading.depth.shape[1] // DEPTH_WIDTH)
    if step == 1:
        return reading
    first = step // 2

    def take(values: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "k l"]:
        return np.ascontiguousarray(values[first::step, first::step])

    depth = take(reading.depth)
    k = reading.camera.intrinsics
    cx, cy = ((c - first - 0.5) / step + 0.5 for c in (k.cx, k.cy))
    intrinsics = Intrinsics(depth.shape[1], depth.shape[0], k.fx / step, k.fy / step, cx, cy)
    confidence = None if reading.confidence is None else take(reading.confidence)
    return DepthReading(depth, Camera(intrinsics, reading.camera.pose), confidence)
