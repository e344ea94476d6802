"""Pairs from a posed capture: its frames with the depth of the sensor, of a surface, or both.

A sensor's depth is noisy and has holes. A surface fused from many frames has fewer of both and gives normals too;
it is cast into each frame. It counts only where it can be relied on: where there is any, where it is not seen at a
grazing angle, and where the frame's own reading says the same. That leaves out most borders, which a fusion rounds
off: so `"both"` takes the frame's reading, without a normal, wherever the surface does not count."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from hyjax.data.capture import Capture, ChosenFrames
from hyjax.data.registry import open_capture
from hyjax.geometry.depth_map import confirmed
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.surface import with_normals
from hyjax.pairs.depth_pairs import DepthPair, Options, PairsKind, Unit, masked_pair, selected
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.surfaces import surface_of
from hyjax.util.errors import InputError
from hyjax.util.files import digest

Source = Literal["sensor", "surface", "both"]
VOXEL = 0.02
"""Width of a voxel of the fusion, in metres."""
SMOOTHING = 4
"""Number of smoothing passes over the normals."""
GRAZING_COSINE = 0.15
"""Cosine of the viewing angle below which a surface does not count."""


class CapturePairs:
    """Pairs (`DepthPairs`) from the frames with depth of a capture.

    Args:
        indices: of the frames to take; a surface is made of these alone.
    """

    unit: Unit = "metres"

    def __init__(
        self, capture: Capture, indices: Sequence[int], depth: Source = "sensor", progress: bool = True
    ) -> None:
        self.name, self._total = capture.name, len(capture)
        self._frames, self._depth = ChosenFrames(capture, indices), depth
        first = self._frames[0]
        if first.depth is None:
            raise InputError(f"{capture.name}: the capture has no depth; take one with a depth camera")
        if first.depth_intrinsics is not None and depth != "surface":
            raise InputError(f"{capture.name}: depth is not registered to the pictures; use depth=surface")
        self._caster: RayCaster | None = None
        if depth != "sensor":
            fusion = FusionSettings(voxel=VOXEL, fuse_frames=0)
            _, mesh = surface_of(self._frames, "fused", fusion=fusion, progress=progress)
            self._caster = RayCaster(with_normals(mesh, SMOOTHING))

    @property
    def fingerprint(self) -> str:
        """Fingerprint, see `DepthPairs`; without the place and times of files, which are in the capture's."""
        first = self._frames[0]
        pose = np.round(first.camera.pose, 6).tolist()
        which = f"{self._frames.indices} of {self._total}"
        return digest([self.name, f"{first.camera.intrinsics} {pose}", self._depth, which])

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> DepthPair:
        frame = self._frames[index]
        where = f"{self.name} {frame.name}"
        if self._caster is None:
            return masked_pair(frame.name, frame.image, np.asarray(frame.depth), self.unit, where=where)
        gbuffer = self._caster.gbuffer(frame.camera)
        depth, normal = np.asarray(gbuffer.depth), np.asarray(gbuffer.normal)
        rays = frame.camera.rays()
        cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
        valid = (
            np.asarray(gbuffer.hit)
            & (cosine > GRAZING_COSINE)
            & confirmed(frame, np.asarray(gbuffer.position), unread=True)
        )
        normal = normal @ frame.camera.pose[:3, :3]  # world axes → camera axes
        if self._depth == "both":
            depth, normal = np.where(valid, depth, np.asarray(frame.depth)), np.where(valid[..., None], normal, 0)
            valid = np.ones_like(valid)
        return masked_pair(frame.name, frame.image, depth, self.unit, where=where, valid=valid, normal=normal)


def _open(path: Path, options: Options) -> CapturePairs:
    capture = open_capture(path)
    depth = options.get("depth", "sensor")
    if depth not in get_args(Source):
        raise InputError(f"{path}: depth={depth} is unknown; use one of {', '.join(get_args(Source))}")
    return CapturePairs(capture, selected(options, len(capture)), cast(Source, depth))


KIND = PairsKind("capture", _open, ("depth",), selects=True)
