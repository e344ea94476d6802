"""Depth sensors: range and reliability of their readings."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class DepthSensor:
    """A kind of depth camera.

    Attributes:
        far: metres beyond which readings are too coarse to fuse; None where it is not known.
        truncation: half width of the band around a surface in which it is fused, in voxels.
    """

    name: str
    far: float | None = None
    truncation: float = 4.0


KINECT = DepthSensor("Kinect", 4.0)
"""First generation, structured light: noise at 4 m is 2 to 4 cm (Khoshelham & Elberink, Sensors 2012)."""
PHONE_LIDAR = DepthSensor("phone LiDAR", 5.0, truncation=3.0)
"""iPhone and iPad Pro since 2020: 256×192, upsampled by the phone from a sparse grid, so wrong at borders. A band
of three voxels in place of four bloats them less; see `experiments.fusion_borders`."""
UNKNOWN = DepthSensor("depth camera")
