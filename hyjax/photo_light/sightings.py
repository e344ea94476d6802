"""Sightings: coarse frames for the search for light sources, and the box that closes the scan."""

import dataclasses

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from hyjax.data.capture import Frame
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.transport_rays import wall_axes
from hyjax.photo_light.radiance import black_margin
from hyjax.photo_light.sources import SATURATED_VALUE, Vector

ROW_PIXELS = 320
"""Length of a sighting's row, in pixels."""


@dataclasses.dataclass(frozen=True)
class Sighting:
    """Coarse pixels of a frame: rays, depth and triangle of the surface, brightness.

    Attributes:
        rays: of unit depth.
        depth: of the surface; infinite without.
        face: triangle that is seen, −1 without.
        low: least of the three channels, display values; 0 on a white border.
        known: pixels that are neither of a white border nor of a black margin.
    """

    frame: Frame
    rays: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    face: Int[np.ndarray, "h w"]
    low: Float[np.ndarray, "h w"]
    known: Bool[np.ndarray, "h w"]

    @property
    def burnt(self) -> Bool[np.ndarray, "h w"]:
        """Mask of burnt-out pixels."""
        return self.low > SATURATED_VALUE


def sight(caster: RayCaster, frame: Frame) -> Sighting:
    """Make the sighting of a frame."""
    step = max(1, frame.camera.intrinsics.width // ROW_PIXELS)
    rays = frame.camera.rays()[step // 2 :: step, step // 2 :: step]
    hits = caster.cast(frame.camera.origin, rays.reshape(-1, 3))
    shape = rays.shape[:2]
    image = frame.image[step // 2 :: step, step // 2 :: step]
    low = image.min(axis=-1)
    known = ~_white_border(low > SATURATED_VALUE) & ~black_margin(image)
    depth, face = hits.distance.reshape(shape), hits.face.reshape(shape)
    return Sighting(frame, rays, depth, face, np.where(known, low, 0.0), known)


def _white_border(burnt: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Rows and columns at the border that are burnt out all along, as in undistorted pictures."""
    white = np.zeros_like(burnt)
    for axis in (0, 1):
        lines = burnt.mean(axis=1 - axis) > 0.6
        for direction in (1, -1):
            inner = np.cumprod(lines[::direction])[::direction].astype(bool)
            white |= inner[:, None] if axis == 0 else inner[None]
    return white


Box = tuple[Float[np.ndarray, "5 3"], Float[np.ndarray, "5"]]
"""Outward normals of four walls and the ceiling, and their offsets."""


def closing_box(mesh: trimesh.Trimesh, up: Vector, eyes: Float[np.ndarray, "n 3"]) -> Box:
    """Walls and ceiling as planes beyond all cameras: the outermost surfaces of some area, else the scan's end."""
    normals, areas = np.asarray(mesh.face_normals), np.asarray(mesh.area_faces)
    x, y, _ = wall_axes(mesh, up)
    outward = np.stack([-x, x, -y, y, up])
    return outward, np.array([_outermost(mesh, normals, areas, d, float((eyes @ d).max())) for d in outward])


def _outermost(
    mesh: trimesh.Trimesh, normals: np.ndarray, areas: np.ndarray, outward: Vector, least: float
) -> float:
    """Offset of a wall, `least` or more."""
    facing = np.abs(normals @ outward) > 0.85
    end = max(float(np.quantile(mesh.vertices @ outward, 0.995)), least)
    offsets = mesh.triangles_center[facing] @ outward
    bins = np.arange(least, end + 0.2, 0.02)
    if len(bins) < 2 or not facing.any():
        return end
    area = np.histogram(offsets, bins, weights=areas[facing])[0]
    near = np.convolve(area, np.ones(5), "same")  # within 5 cm
    strong = np.flatnonzero(near > max(0.4, 0.3 * near.max()))
    if not len(strong):
        return end
    last = strong[-1]
    first = last
    while first - 1 in strong and last - first < 10:
        first -= 1
    peak = first + int(np.argmax(near[first : last + 1]))
    return float(bins[peak] + 0.01)


def exits(box: Box, origin: Vector, rays: Float[np.ndarray, "*s 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Ray parameter and wall of each ray's exit from the box; infinite and 5 downwards."""
    outward, offsets = box
    along = rays @ outward.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(along > 1e-9, (offsets - outward @ origin) / along, np.inf)
    t = np.where(t > 0, t, np.inf)
    first = t.min(axis=-1)
    return first, np.where(np.isfinite(first), t.argmin(axis=-1), len(offsets))
