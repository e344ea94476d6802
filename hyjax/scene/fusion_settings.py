"""Settings of the fusion of depth maps."""

import dataclasses
from typing import Literal

from hyjax.util.errors import InputError
from hyjax.util.settings import Settings

Align = Literal["auto", "yes", "no"]
MAX_FUSED_FRAMES = 150
"""Default number of depth maps of a fusion."""
LEAST_RANGE = 0.1
"""Least range of readings, in metres."""


FUSED = "fusion of"
"""Beginning of the source of a surface that was fused, see `Scene.source`."""


@dataclasses.dataclass(frozen=True)
class FusionSettings(Settings):
    """Settings of the fusion of depth maps to a mesh. Defaults follow from the sensor and the place."""

    voxel: float | None = None
    """Voxel of the fusion in metres. Default: 1.5 % of the median depth, 2 to 4 cm."""
    depth_range: float | None = None
    """Largest depth of fused readings in metres. Default: 5 for a phone's LiDAR, 4 for a Kinect, else the seen
    depth; more where over a tenth of the readings lie beyond."""
    confidence: float = 0.5
    """Least confidence of a reading, 0 to 1; phones have 0, 0.5 and 1. More of it weighs more."""
    min_weight: float | None = None
    """Least weight of a voxel; 1 is one view head-on from one metre. Default: 0.1, less for few or far views."""
    fuse_frames: int = MAX_FUSED_FRAMES
    """Most depth maps to fuse, spread over the capture; 0 for all. A stopped fusion continues."""
    align: Align = "auto"
    """Alignment of the poses by the depth maps before the fusion: yes, no, or auto, for a phone's LiDAR only. They
    stay as they are where held-out depth is not covered better."""

    def check(self) -> "FusionSettings":
        """Return these settings if they are valid.

        Raises:
            InputError: one is out of range.
        """
        if self.voxel is not None and not 0 < self.voxel <= 1:
            raise InputError(f"voxel: must lie in (0, 1] metres, got {self.voxel:g}")
        if self.depth_range is not None and not LEAST_RANGE < self.depth_range <= 1000:
            raise InputError(f"depth range: must lie in ({LEAST_RANGE:g}, 1000] metres, got {self.depth_range:g}")
        if not 0 <= self.confidence <= 1:
            raise InputError(f"confidence: must lie in [0, 1], got {self.confidence:g}")
        if self.min_weight is not None and not 0 <= self.min_weight < float("inf"):
            raise InputError(f"min weight: must be >= 0, got {self.min_weight:g}")
        if self.fuse_frames < 0:
            raise InputError(f"fuse frames: must be >= 0, got {self.fuse_frames}")
        return self
