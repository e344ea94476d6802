"""Fusion of a capture's depth maps, with a range, voxels and weights that follow from its sensor and its place."""

import dataclasses
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import trimesh

from hyjax.data.capture import Capture
from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import NEAR_LIMIT, DepthReading
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.tsdf import fuse
from hyjax.scene.fusion_settings import FUSED, FusionSettings
from hyjax.util.errors import InputError
from hyjax.util.prefetch import prefetch

FAR_SHARE = 0.1
"""Least share of readings beyond a sensor's range for which they are fused, too."""
LONGEST_RANGE = 10.0
"""Largest range of an unknown sensor, in metres."""
VOXEL_SHARE = 0.015
"""Ratio of voxel to median depth."""
SMALLEST_VOXEL, LARGEST_VOXEL = 0.02, 0.04
"""Bounds of the default voxel, in metres."""
FEW_MAPS = 50
"""Number of depth maps below which the least weight of a voxel is lowered."""
SAMPLED_MAPS = 12
"""Number of depth maps to choose settings from, and to judge the result by."""
LOW_COVERAGE = 0.8
"""Coverage below which a warning is given."""
LEAST_OVERLAP = 0.05
"""Least share of depth readings that meet a mesh; below it the mesh lies elsewhere."""
EMPTY_READING = DepthReading(np.zeros((1, 1), np.float32), Camera(Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5), np.eye(4)))
"""Depth map without readings, in place of a damaged one."""
_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class FusionPlan:
    """Parameters of a fusion, with lengths in metres.

    Attributes:
        indices: of the depth maps.
        voxel, truncation, far: see `hyjax.geometry.tsdf.fuse`.
        min_weight: least weight of a voxel.
        confidence: least confidence of a reading.
    """

    indices: tuple[int, ...]
    voxel: float
    truncation: float
    far: float
    min_weight: float
    confidence: float

    def __str__(self) -> str:
        return f"{FUSED} {len(self.indices)} depth maps, voxels of {self.voxel:g} m, up to {self.far:g} m"


class Readings:
    """Chosen depth maps of a capture, read on demand, and of readings those of a least confidence.

    Damaged ones are left out with a line.
    """

    def __init__(self, capture: Capture, indices: Sequence[int], confidence: float) -> None:
        self._capture, self._indices, self._confidence = capture, indices, confidence

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[DepthReading]:
        return self.start(0)

    def start(self, first: int) -> Iterator[DepthReading]:
        """Iterate over the depth maps from a position. A damaged one comes without readings."""
        return prefetch(self._read, self._indices[first:])

    def _read(self, index: int) -> DepthReading:
        try:
            depth, camera, confidence = self._capture.depth_reading(index)
        except InputError as error:
            if self._capture.strict:
                raise
            _log.warning("%s; left out of the fusion", error)
            return EMPTY_READING
        if confidence is not None:
            depth = np.where(confidence >= self._confidence, depth, np.float32(0.0))
        return DepthReading(depth, camera, confidence)


def plan_fusion(capture: Capture, settings: FusionSettings) -> FusionPlan:
    """Choose range, voxel and weights for a capture from a few of its depth maps."""
    settings.check()
    count = capture.depth_count
    if not count:
        raise InputError(f"{capture.name}: the capture has no depth to make a mesh of; give one with --mesh FILE")
    most = settings.fuse_frames or count
    indices = tuple(range(0, count, -(-count // most)))
    seen = [
        r.depth[::4, ::4].ravel() for r in Readings(capture, spread(indices, SAMPLED_MAPS), settings.confidence)
    ]
    depth = np.concatenate(seen)
    depth = depth[np.isfinite(depth) & (depth > NEAR_LIMIT)]
    if not len(depth):
        raise InputError(f"{capture.name}: its depth maps have no readings; give a mesh with --mesh FILE")
    far = settings.depth_range
    if far is None:
        far = capture.sensor.far or LONGEST_RANGE
        if (depth > far).mean() > FAR_SHARE or capture.sensor.far is None:
            far = min(2 * far, float(np.ceil(2 * np.quantile(depth, 0.98)) / 2 + 0.5))
    voxel = settings.voxel
    if voxel is None:
        voxel = min(max(round(VOXEL_SHARE * float(np.median(depth)), 2), SMALLEST_VOXEL), LARGEST_VOXEL)
    weight = settings.min_weight
    if weight is None:
        weight = 0.1 * float(np.clip(len(indices) / FEW_MAPS, 0.2, 1.0)) * min(1.0, (4.0 / far) ** 2)
    return FusionPlan(indices, voxel, capture.sensor.truncation * voxel, far, weight, settings.confidence)


def fuse_capture(
    capture: Capture, plan: FusionPlan, *, checkpoint: Path | None = None, progress: bool = True
) -> trimesh.Trimesh:
    """Fuse a capture's depth maps to a mesh, see `fuse`."""
    frames = Readings(capture, plan.indices, plan.confidence)
    return fuse(
        frames,
        plan.voxel,
        plan.truncation,
        plan.far,
        plan.min_weight,
        progress,
        checkpoint=checkpoint,
    )


def coverage_of(capture: Capture, mesh: trimesh.Trimesh | MeshArrays | None, confidence: float = 0.5) -> Coverage:
    """Coverage of a few of a capture's depth maps by a mesh."""
    indices = spread(range(capture.depth_count), SAMPLED_MAPS)
    return Coverage.of(None if mesh is None else RayCaster(mesh), Readings(capture, indices, confidence))


def tell_coverage(capture: Capture, description: str, coverage: Coverage) -> None:
    """Warn of a mesh that covers little of the measured depth, or lies elsewhere."""
    if not coverage.measured:
        _log.warning("%s: its depth maps have no readings, so the %s cannot be judged", capture.name, description)
    elif coverage.hit < LEAST_OVERLAP:
        _log.warning(
            "%s: the %s is met by %.0f %% of the depth readings; are mesh and poses in the same axes and units?",
            capture.name,
            description,
            100 * coverage.hit,
        )
    elif coverage.covered < LOW_COVERAGE:
        _log.warning(
            "%s: the %s agrees with %.0f %% of the depth readings (%.3g m off, median); its holes are lit as their "
            "surroundings are",
            capture.name,
            description,
            100 * coverage.covered,
            coverage.distance,
        )
