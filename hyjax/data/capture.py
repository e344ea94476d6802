"""What every capture format is read into."""

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from hyjax.errors import InputError
from hyjax.scene.camera import Camera, Intrinsics


@dataclasses.dataclass(frozen=True)
class Frame:
    """One posed picture.

    Attributes:
        name: short and unique within the capture; output files are named after it.
        image: display-encoded (sRGB) colours in [0, 1].
        camera: intrinsics of `image` and camera-to-world pose.
        time: seconds since the capture's start.
        depth: distance along the camera's axis in metres, 0 where there is no reading; None without a sensor.
        depth_intrinsics: of `depth`, where its size or lens differs from the image's; None if they are the same.
    """

    name: str
    image: Float[np.ndarray, "h w 3"]
    camera: Camera
    time: float
    depth: Float[np.ndarray, "dh dw"] | None = None
    depth_intrinsics: Intrinsics | None = None

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[:2] != self.camera.intrinsics.shape:
            k = self.camera.intrinsics
            raise InputError(
                f"frame {self.name}: picture is {self.image.shape[1]}x{self.image.shape[0]} but its intrinsics "
                f"are for {k.width}x{k.height}; give the intrinsics of this picture size"
            )

    @property
    def depth_camera(self) -> Camera:
        """The camera that `depth` belongs to."""
        if self.depth_intrinsics is None:
            return self.camera
        return Camera(self.depth_intrinsics, self.camera.pose)


@runtime_checkable
class Capture(Protocol):
    """A sequence of frames of one place. Frames are read when asked for, so that long captures fit in memory."""

    name: str
    up: Float[np.ndarray, "3"]
    """Unit vector against gravity in world coordinates."""

    @property
    def fingerprint(self) -> str:
        """Changes whenever the capture's content does; what is made from a capture is cached under it."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...
