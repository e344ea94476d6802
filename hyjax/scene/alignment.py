"""Alignment of a capture's frames: registration of depth maps removes the drift of a phone's tracking.

A phone's poses are off by centimetres from one end of a walk to the other. Fused as they are, thin things vanish
and borders swell, and the surface lies beside the picture. Half of the depth maps are registered to each other, the
other half to their surface; if it covers that other half no better than before, the poses stay as they are.
"""

import dataclasses
import functools
import logging
from collections.abc import Sequence

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, DerivedCapture, Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.registration import register, registered
from hyjax.geometry.tsdf import fuse
from hyjax.scene.fusion import FusionPlan, Readings, plan_fusion
from hyjax.scene.fusion_settings import MAX_FUSED_FRAMES, FusionSettings
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError
from hyjax.util.files import digest

VERSION = 1
"""Version of the alignment. Add one when its poses change."""
FEWEST_MAPS = 8
"""Fewest depth maps to align."""
LEAST_GAIN = 0.005
"""Least gain of coverage of held-out depth by aligned poses."""
_log = logging.getLogger(__name__)


def aligned(capture: Capture, settings: FusionSettings, progress: bool = True) -> Capture:
    """Align the poses of a capture; return it as it is where that is not wanted, not possible or no better.

    Args:
        capture: with depth.
        settings: of its fusion; `align` among them.
        progress: show bars on stderr.
    """
    wanted = settings.align == "yes" or (settings.align == "auto" and capture.sensor == PHONE_LIDAR)
    if not wanted or isinstance(capture, AlignedCapture) or capture.depth_count < FEWEST_MAPS:
        return capture
    most = min(settings.fuse_frames or MAX_FUSED_FRAMES, MAX_FUSED_FRAMES)
    try:
        plan = plan_fusion(capture, dataclasses.replace(settings, fuse_frames=most))
        corrections = cached_arrays(
            cache_folder() / f"alignment-{digest([f'{VERSION}', capture.fingerprint, repr(plan)])}.npz",
            functools.partial(_corrections, len(plan.indices)),
            lambda: _align(capture, plan, progress),
        )
    except InputError as error:
        _log.warning("%s: poses are taken as they are: %s", capture.name, error)
        return capture
    if corrections is None:
        return capture
    return AlignedCapture(capture, np.array(plan.indices), corrections)


def _corrections(count: int, arrays: Arrays) -> Float[np.ndarray, "n 4 4"] | None:
    corrections = arrays["corrections"]
    if corrections.shape not in ((0, 4, 4), (count, 4, 4)) or not np.all(np.isfinite(corrections)):
        raise ValueError("not the corrections of these depth maps")
    return corrections if len(corrections) else None


def _align(capture: Capture, plan: FusionPlan, progress: bool) -> Arrays:
    """Corrections of the poses as motions; none if they are no better."""
    readings = list(Readings(capture, plan.indices, plan.confidence))

    def fused(maps: Sequence[DepthReading]) -> trimesh.Trimesh:
        return fuse(maps, plan.voxel, plan.truncation, plan.far, plan.min_weight, progress=False)

    fitted, heldout = readings[::2], readings[1::2]
    before = Coverage.of(RayCaster(fused(fitted)), heldout)
    moved = register(fitted, fused, plan.far, progress=progress)
    caster = RayCaster(fused(moved))
    others = [registered(reading, caster, plan.far) for reading in heldout]
    after = Coverage.of(caster, others)
    if after.covered < before.covered + LEAST_GAIN:
        return {"corrections": np.zeros((0, 4, 4))}
    final = [(moved if k % 2 == 0 else others)[k // 2] for k in range(len(readings))]
    pairs = zip(final, readings, strict=True)
    return {"corrections": np.stack([new.camera.pose @ np.linalg.inv(old.camera.pose) for new, old in pairs])}


class AlignedCapture(DerivedCapture):
    """Capture with corrected poses.

    Args:
        capture: as it was.
        indices: of the depth maps whose corrections are known, ascending.
        corrections: motions of the world that correct their poses; between them they are interpolated.
    """

    def __init__(
        self, capture: Capture, indices: Float[np.ndarray, "n"], corrections: Float[np.ndarray, "n 4 4"]
    ) -> None:
        super().__init__(capture)
        self._indices, self._corrections = np.asarray(indices, float), corrections

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return digest([self.source.fingerprint, np.round(self._corrections, 6).tobytes().hex()])

    @property
    def moved(self) -> Float[np.ndarray, "n"]:
        """Distances that the cameras of the frames have moved, in metres."""
        count = len(self)
        return np.array(
            [np.linalg.norm(self.camera(k).origin - self.source.camera(k).origin) for k in range(count)]
        )

    def __getitem__(self, index: int) -> Frame:
        frame = self.source[index]
        return dataclasses.replace(frame, camera=self._corrected(frame.camera, self._position(index)))

    def camera(self, index: int) -> Camera:
        """See `Capture`."""
        return self._corrected(self.source.camera(index), self._position(index))

    def depth_reading(self, index: int) -> DepthReading:
        """See `Capture`."""
        reading = self.source.depth_reading(index)
        return reading._replace(camera=self._corrected(reading.camera, float(index)))

    def _position(self, index: int) -> float:
        return self.source.depth_position(range(len(self))[index])

    def _corrected(self, camera: Camera, position: float) -> Camera:
        right = int(np.clip(np.searchsorted(self._indices, position), 1, max(len(self._indices) - 1, 1)))
        pair = self._corrections[[right - 1, min(right, len(self._corrections) - 1)]]
        first, second = self._indices[right - 1], self._indices[min(right, len(self._indices) - 1)]
        share = float(np.clip((position - first) / max(second - first, 1e-9), 0.0, 1.0))
        motion = np.eye(4)
        turns = Rotation.from_matrix(pair[:, :3, :3])
        between = (turns[0].inv() * turns[1]).as_rotvec()
        motion[:3, :3] = (turns[0] * Rotation.from_rotvec(share * between)).as_matrix()
        # Places are mixed at the camera: the world's origin may be far away.
        at_camera = pair[:, :3, :3] @ camera.origin + pair[:, :3, 3]
        motion[:3, 3] = (1 - share) * at_camera[0] + share * at_camera[1] - motion[:3, :3] @ camera.origin
        return Camera(camera.intrinsics, motion @ camera.pose)
