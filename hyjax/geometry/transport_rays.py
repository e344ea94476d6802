"""Casting the rays of light transport, on the host: once a scan."""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture
from hyjax.util.prefetch import prefetch
from hyjax.util.progress import StepBar
from hyjax.util.vectors import fibonacci_disc, orthonormal_frame

if TYPE_CHECKING:
    import trimesh

RAYS, FEWEST_RAYS, MOST_RAYS_IN_ALL = 256, 32, 16_000_000
"""Rays of a point; fewer where a scan has so many points that all their rays would take too long."""
OFFSET = 0.01
"""Metres off the surface at which rays start: a rough mesh has bumps of this size."""
CELLS = 4
"""Patches along each side of a wall of the box."""
MARGIN = 0.02
"""Margin of the box around the scan, metres."""
LEAST_SIDE = 1.0
"""Least length of a side of the box, metres."""
CHUNK = 1 << 18


@dataclasses.dataclass(frozen=True)
class Box:
    """The box round a scan that stands for the walls that were not scanned.

    Attributes:
        axes: rows are its axes, the last one up.
        low, high: its extent along them, metres.
    """

    axes: Float[np.ndarray, "3 3"]
    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    def patches(self) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Centres and inward normals of all patches: wall by wall (−x, +x, −y, +y, −z, +z), rows, columns."""
        centres, normals = [], []
        ticks = (np.arange(CELLS) + 0.5) / CELLS
        for axis in range(3):
            for side in (0, 1):
                place = np.empty((CELLS, CELLS, 3))
                place[..., axis] = side
                place[..., (axis + 1) % 3], place[..., (axis + 2) % 3] = np.meshgrid(ticks, ticks, indexing="ij")
                centres.append((self.low + place * (self.high - self.low)).reshape(-1, 3) @ self.axes)
                normals.append(np.broadcast_to((1 - 2 * side) * self.axes[axis], (CELLS**2, 3)))
        return np.concatenate(centres), np.concatenate(normals)

    def exit_patches(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Int[np.ndarray, "n"]:
        """Patches at which rays from inside leave."""
        kind = directions.dtype
        o = (self.axes @ origins.T - self.low[:, None]).astype(kind)  # components in rows: a pass each
        d, size = self.axes.astype(kind) @ directions.T, (self.high - self.low).astype(kind)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (np.where(d > 0, size[:, None], 0.0) - o) / d
        far[d == 0] = np.inf
        distance = np.maximum(np.minimum(np.minimum(far[0], far[1]), far[2]), 0.0)
        axis = np.where(far[0] <= distance, 0, np.where(far[1] <= distance, 1, 2))
        place = (o + distance * d) * (CELLS / size[:, None])
        cell = np.minimum(np.maximum(place, 0.0).astype(np.int16), CELLS - 1)
        by_axis = [((2 * k + (d[k] > 0)) * CELLS + cell[(k + 1) % 3]) * CELLS + cell[(k + 2) % 3] for k in range(3)]
        return np.choose(axis, by_axis)


def wall_axes(mesh: "trimesh.Trimesh", up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Axes of a scan: two of them along most of its walls, the last one `up`."""
    frame = orthonormal_frame(up)
    x, y, z = (np.asarray(mesh.face_normals) @ frame.T).T
    upright = np.abs(z) < 0.3
    # Walls repeat every quarter turn: the mean direction of four times the angle.
    angles, areas = np.arctan2(y[upright], x[upright]), np.asarray(mesh.area_faces)[upright]
    angle = np.angle(np.sum(areas * np.exp(4j * angles))) / 4
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ frame


def enclose(caster: RayCaster, up: Float[np.ndarray, "3"]) -> Box:
    """Box of a scan: turned about `up` so that most of the surface is parallel to its walls.

    A flat or narrow scan has a box of `LEAST_SIDE` above and around it: closer, light could take any form on it.
    """
    axes = wall_axes(caster.mesh, up)
    local = np.asarray(caster.mesh.vertices)[np.unique(caster.mesh.faces)] @ axes.T
    low, high = np.quantile(local, 0.002, axis=0) - MARGIN, np.quantile(local, 0.998, axis=0) + MARGIN
    lacking = np.maximum(LEAST_SIDE - (high - low), 0.0)
    return Box(axes, low - lacking * [0.5, 0.5, 0.0], high + lacking * [0.5, 0.5, 1.0])


def cosine_directions(count: int) -> Float[np.ndarray, "n 3"]:
    """Cosine-distributed directions about +z (Malley's method on a Fibonacci disc)."""
    disc = fibonacci_disc(count)
    return np.column_stack([disc, np.sqrt(1.0 - np.sum(disc**2, axis=1))])


def trace(
    caster: RayCaster,
    box: Box,
    windows: Sequence[Aperture] = (),
    *,
    rays: int = RAYS,
    seed: int = 0,
    progress: bool = False,
) -> tuple[Int[np.ndarray, "r p"], Float[np.ndarray, "p 3"], Float[np.ndarray, "p 3"]]:
    """Radiators at the ends of all points' rays.

    Returns:
        hits, positions, normals.
    """
    mesh = caster.mesh
    centres, inward = box.patches()
    position = np.concatenate([mesh.vertices, centres])
    # A vertex that no triangle uses, or whose triangles cancel out, has no normal: any does.
    own = np.asarray(mesh.vertex_normals)
    usable = np.isfinite(own).all(axis=1) & (np.linalg.norm(own, axis=1) > 0.5)
    normal = np.concatenate([np.where(usable[:, None], own, [0.0, 0.0, 1.0]), inward])
    rays = int(np.clip(MOST_RAYS_IN_ALL // len(position), min(rays, FEWEST_RAYS), rays))
    lobe = cosine_directions(rays).astype(np.float32)
    rng = np.random.default_rng(seed)
    turns = rng.uniform(0, 2 * np.pi, len(position))
    # Frames turned about their normals, and rays of single precision, as Embree has them.
    x, y, z = np.moveaxis(orthonormal_frame(normal), 1, 0)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    frames = np.stack([c * x + s * y, c * y - s * x, z], axis=1).astype(np.float32)
    start = position + OFFSET * normal
    count = len(mesh.faces)
    hits = np.empty((rays, len(position)), np.int32)
    step = max(1, CHUNK // rays)

    def ends(first: int) -> None:
        part = slice(first, first + step)
        directions = lobe @ frames[part]
        end = caster.nearest_faces(start[part], directions).reshape(-1)
        missed = np.flatnonzero(end < 0)
        starts, directions = start[part][missed // rays], directions.reshape(-1, 3)[missed]
        end[missed] = count + box.exit_patches(starts, directions)
        for window in windows:
            end[missed[through(window, starts, directions)]] = count + len(centres)
        hits[:, part] = end.reshape(-1, rays).T

    blocks = range(0, len(position), step)
    with contextlib.closing(prefetch(ends, blocks, threads=2)) as done:  # Embree and NumPy in turns
        for _ in StepBar(done, "light transport", total=len(blocks), disable=not progress, unit="block"):
            pass
    return hits, position, normal


def through(window: Aperture, origins: np.ndarray, directions: np.ndarray) -> Bool[np.ndarray, "n"]:
    """Whether rays leave through a rectangle."""
    centre, right, up = (np.asarray(v, np.float64) for v in (window.center, window.right, window.up))
    normal = np.cross(right, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (centre - origins) @ normal / (directions @ normal)
    t = np.where(np.isfinite(t), t, -1.0)
    place = origins + t[:, None] * directions - centre
    inside = (np.abs(place @ right) <= right @ right) & (np.abs(place @ up) <= up @ up)
    return inside & (t > 0) & (directions @ normal < 0)
