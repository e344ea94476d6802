"""Pinhole camera (host side).

Axes: +x right, +y down, +z forward, right-handed; poses are camera-to-world; metres and radians.
Pixel coordinates are continuous: pixel (row i, column j) covers [j, j+1] × [i, i+1] and has its centre at
(j + 0.5, i + 0.5). Cropping is then a shift and resizing a scaling of the intrinsics, with no half-pixel terms.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown

# A pose read from a text file carries six or seven digits; scanners' trackers are orthonormal to about 1e-4.
RIGID_TOLERANCE = 1e-3
LARGEST_DISTANCE = 1e9
"""Largest distance in the unit of the poses; beyond it, corners of a room coincide in float32."""
LARGEST_SIDE = 1 << 20
SHORTEST_FOCAL = 1e-3
"""Pixels; at 1e-300 nothing that follows is a number."""
LARGEST_VALUE = 1e7
"""Pixels, of focal lengths and of the principal point."""


@checked_arguments
@dataclasses.dataclass(frozen=True)
class Intrinsics:
    """Pinhole intrinsics in pixels of a `width` × `height` image."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy)
        if self.width < 1 or self.height < 1:
            raise InputError(f"intrinsics: image size {self.width}x{self.height} must be at least 1x1")
        if max(self.width, self.height) > LARGEST_SIDE:
            raise InputError(
                f"intrinsics: image size {self.width}x{self.height} must be at most {LARGEST_SIDE} a side"
            )
        if not np.all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise InputError(f"intrinsics: focal lengths fx={self.fx}, fy={self.fy} must be > 0, all values finite")
        if min(self.fx, self.fy) < SHORTEST_FOCAL or np.abs(values).max() > LARGEST_VALUE:
            raise InputError(
                f"intrinsics: fx={self.fx:g}, fy={self.fy:g}, cx={self.cx:g}, cy={self.cy:g} are no camera's; must "
                f"be {SHORTEST_FOCAL:g} to {LARGEST_VALUE:g} pixels"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), as arrays have it."""
        return self.height, self.width

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The 3×3 calibration matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @checked_arguments
    def crop(self, top: int, left: int, height: int, width: int) -> "Intrinsics":
        """Intrinsics of the window of `height` × `width` pixels whose first pixel is (top, left)."""
        return dataclasses.replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    @checked_arguments
    def resize(self, height: int, width: int) -> "Intrinsics":
        """Intrinsics of the same view resampled to `height` × `width` pixels."""
        sx, sy = width / self.width, height / self.height
        return Intrinsics(width, height, self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy)

    @checked_arguments
    def turned(self, quarters: int) -> "Intrinsics":
        """Intrinsics of the picture turned clockwise by `quarters` quarter turns."""
        k = self
        for _ in range(quarters % 4):
            k = Intrinsics(k.height, k.width, k.fy, k.fx, k.height - k.cy, k.cx)
        return k


@checked_arguments
@dataclasses.dataclass(frozen=True)
class Camera:
    """Intrinsics and a pose (4×4 camera-to-world, metres)."""

    intrinsics: Intrinsics
    pose: Float[np.ndarray, "4 4"]

    def __post_init__(self) -> None:
        check_pose(self.pose)

    @checked_arguments
    def turned(self, quarters: int) -> "Camera":
        """The camera of the picture turned clockwise by `quarters` quarter turns; each pixel keeps its ray."""
        # The new picture's x runs along the old -y, its y along the old x.
        quarter = np.array(
            [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        )
        pose = self.pose @ np.linalg.matrix_power(quarter, quarters % 4)
        return Camera(self.intrinsics.turned(quarters), pose)

    @property
    def origin(self) -> Float[np.ndarray, "3"]:
        """Centre of projection in world coordinates."""
        return self.pose[:3, 3]

    def rays(self) -> Float[np.ndarray, "h w 3"]:
        """Directions through all pixel centres in world axes, scaled to unit *depth* (camera z = 1)."""
        k = self.intrinsics
        x = (np.arange(k.width) + 0.5 - k.cx) / k.fx
        y = (np.arange(k.height) + 0.5 - k.cy) / k.fy
        local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
        return local @ self.pose[:3, :3].T

    @checked_arguments
    def project(
        self, points: Float[np.ndarray, "*n 3"]
    ) -> tuple[Float[np.ndarray, "*n 2"], Float[np.ndarray, "*n"]]:
        """World points → (pixel coordinates (x, y), depth). Points with depth ≤ 0 lie behind the camera."""
        local = (points - self.origin) @ self.pose[:3, :3]
        depth = local[..., 2]
        k = self.intrinsics
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = local[..., :2] / depth[..., None] * (k.fx, k.fy) + (k.cx, k.cy)
        return xy, depth

    @checked_arguments
    def unproject(self, depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
        """A depth map of this camera's size (metres along its axis) → world points."""
        return self.origin + self.rays() * depth[..., None]


def check_pose(pose: Float[np.ndarray, "4 4"], where: str = "pose") -> None:
    """Raise `InputError` unless `pose` is a rigid motion (rotation and translation)."""
    if not (isinstance(pose, np.ndarray) and pose.dtype.kind in "fiu"):
        raise InputError(f"{where}: need a finite 4x4 camera-to-world matrix, got {shown(pose)}")
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise InputError(f"{where}: need a finite 4x4 camera-to-world matrix, got shape {pose.shape}")
    if np.abs(pose).max() > LARGEST_DISTANCE:
        raise InputError(
            f"{where}: has numbers up to {np.abs(pose).max():.3g}; a pose's are at most {LARGEST_DISTANCE:g}"
        )
    rotation = pose[:3, :3]
    if not np.allclose(pose[3], (0, 0, 0, 1), atol=RIGID_TOLERANCE):
        raise InputError(f"{where}: last row is {pose[3].tolist()}, must be [0, 0, 0, 1]")
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{where}: not a rigid motion (rotation is off orthonormal by {error:.2g}, determinant "
            f"{np.linalg.det(rotation):.3g}); need a rotation with determinant +1"
        )


@checked_arguments
def look_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world pose at `eye`, looking at `target`, with `up` pointing upwards in the image."""
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        raise InputError("look_at: the viewing direction is parallel to `up`; choose another `up`")
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    return pose
