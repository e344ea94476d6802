"""Measured depth maps, and which of their readings are reliable."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float

from hyjax.geometry.camera import Camera
from hyjax.util.errors import InputError

NEAR_LIMIT = 0.1  # metres; nothing nearer is measured by any depth camera
# Neighbouring pixels further apart than a surface seen at this slope (tan 80°) straddle two surfaces.
STEEPEST_SLOPE = 5.7
READING_TOLERANCE = 0.03, 0.02
"""Largest distance of a surface from a reading of it, in metres, and per metre of depth."""


class DepthReading(NamedTuple):
    """A depth map as fusion needs it.

    Attributes:
        depth: metres along the camera's axis, 0 where there is no reading.
        confidence: of each reading, in [0, 1]; None where the device does not tell.
    """

    depth: Float[np.ndarray, "h w"]
    camera: Camera
    confidence: Float[np.ndarray, "h w"] | None = None


class DepthFrame(Protocol):
    """A frame as fusion needs it, such as `hyjax.data.capture.Frame`."""

    @property
    def depth(self) -> Float[np.ndarray, "h w"] | None: ...

    @property
    def depth_camera(self) -> Camera: ...

    @property
    def confidence(self) -> Float[np.ndarray, "h w"] | None: ...


PosedDepth = DepthFrame | DepthReading | tuple[Float[np.ndarray, "h w"], Camera]


def posed_depths(frames: Iterable[PosedDepth]) -> Iterator[DepthReading]:
    """Depth maps of frames, one at a time."""
    for number, frame in enumerate(frames):
        if isinstance(frame, tuple):
            reading = DepthReading(*frame)
        elif frame.depth is None:
            raise InputError(f"frame {number} has no depth map; fusion needs a capture with depth")
        else:
            reading = DepthReading(frame.depth, frame.depth_camera, frame.confidence)
        depth, camera = reading.depth, reading.camera
        if depth.shape != camera.intrinsics.shape:
            raise InputError(
                f"depth map {number} is {depth.shape[1]}x{depth.shape[0]} but its camera is "
                f"{camera.intrinsics.width}x{camera.intrinsics.height}; give the depth camera's intrinsics"
            )
        if reading.confidence is not None and reading.confidence.shape != depth.shape:
            raise InputError(f"depth map {number} and its confidence differ in size")
        yield reading


def clean_depth(depth: Float[np.ndarray, "h w"], camera: Camera, max_depth: float) -> Float[np.ndarray, "h w"]:
    """Depth with 0 for readings of no single surface: invalid, out of range, or next to a jump."""
    usable = np.isfinite(depth) & (depth > NEAR_LIMIT) & (depth < max_depth)
    depth = np.where(usable, depth, 0.0).astype(np.float32)
    from scipy import ndimage  # SciPy is slow to load

    farthest = ndimage.maximum_filter(depth, 3)
    nearest = ndimage.minimum_filter(np.where(usable, depth, np.float32(np.inf)), 3)
    # Two pixels apart across the 3×3 window; one part in twenty is left to the noise of the sensor.
    jump = max(0.05, 2.0 * STEEPEST_SLOPE / camera.intrinsics.fx)
    return np.where(farthest - nearest > jump * depth, np.float32(0.0), depth)


def confirmed(frame: DepthFrame, position: Float[np.ndarray, "h w 3"], *, unread: bool) -> Bool[np.ndarray, "h w"]:
    """Mask of the surface points whose depth a frame's depth map confirms within `READING_TOLERANCE`.

    Args:
        position: world points, one a pixel of any camera.
        unread: what to answer where the depth map has no reading.
    """
    if frame.depth is None:
        return np.full(position.shape[:2], unread)
    return confirmed_by(frame.depth, frame.depth_camera, position.astype(np.float64), unread=unread)


def confirmed_by(
    depth: Float[np.ndarray, "h w"], camera: Camera, position: Float[np.ndarray, "*n 3"], *, unread: bool
) -> Bool[np.ndarray, "*n"]:
    """`confirmed`, of any world points by a depth map and its camera."""
    pixel, expected = camera.project(position)
    height, width = depth.shape
    with np.errstate(invalid="ignore"):
        column, row = np.floor(pixel[..., 0]), np.floor(pixel[..., 1])
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height) & (expected > 0)
    row, column = (np.where(inside, x, 0).astype(int) for x in (row, column))
    measured = np.where(inside, depth[row, column], 0.0)
    return np.where(
        measured > 0, np.abs(measured - expected) < READING_TOLERANCE[0] + READING_TOLERANCE[1] * expected, unread
    )


def view_cosine(depth: Float[np.ndarray, "h w"], camera: Camera, reach: int = 2) -> Float[np.ndarray, "h w"]:
    """Cosine between the surface's normal and the ray, from differences `reach` pixels apart; 1 next to holes.

    With slopes z_u, z_v a surface z(u, v) has the normal (-fx z_u, -fy z_v, z + (u-cx) z_u + (v-cy) z_v), whose
    product with the pixel's ray is z.
    """
    k = camera.intrinsics
    z_u = _slope(depth, 1, reach)
    z_v = _slope(depth, 0, reach)
    u = (np.arange(k.width, dtype=np.float32) + np.float32(0.5 - k.cx))[None, :]
    v = (np.arange(k.height, dtype=np.float32) + np.float32(0.5 - k.cy))[:, None]
    third = depth + u * z_u + v * z_v
    normal = np.sqrt(np.float32(k.fx**2) * z_u**2 + np.float32(k.fy**2) * z_v**2 + third**2)
    ray = np.sqrt((u / np.float32(k.fx)) ** 2 + (v / np.float32(k.fy)) ** 2 + 1.0)
    return np.where(depth > 0, depth / np.maximum(normal * ray, np.float32(1e-12)), np.float32(1.0))


def _slope(depth: Float[np.ndarray, "h w"], axis: int, reach: int) -> Float[np.ndarray, "h w"]:
    """Central difference along an axis in metres a pixel; 0 where a neighbour has no reading."""
    moved = np.moveaxis(depth, axis, 0)
    slope = np.zeros_like(moved)
    ahead, behind = moved[2 * reach :], moved[: -2 * reach]
    slope[reach:-reach] = np.where((ahead > 0) & (behind > 0), (ahead - behind) / (2 * reach), 0.0)
    return np.moveaxis(slope, 0, axis)
