"""Casting the rays of light transport, on the host: once a scan."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Aperture
from hyjax.util.progress import StepBar
from hyjax.util.vectors import orthonormal_frame

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

    def exits(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Exits of rays from inside: distance, and the patch there."""
        o, d = origins @ self.axes.T, directions @ self.axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(d > 0, (self.high - o) / d, np.where(d < 0, (self.low - o) / d, np.inf))
        far = np.maximum(far, 0.0)
        axis = np.argmin(far, axis=1)
        n = np.arange(len(o))
        distance = far[n, axis]
        place = (o + distance[:, None] * d - self.low) / (self.high - self.low)
        cell = np.clip((place * CELLS).astype(int), 0, CELLS - 1)
        wall = 2 * axis + (d[n, axis] > 0)
        return distance, (wall * CELLS + cell[n, (axis + 1) % 3]) * CELLS + cell[n, (axis + 2) % 3]


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
    local = np.asarray(caster.mesh.vertices) @ axes.T
    low, high = np.quantile(local, 0.002, axis=0) - MARGIN, np.quantile(local, 0.998, axis=0) + MARGIN
    lacking = np.maximum(LEAST_SIDE - (high - low), 0.0)
    return Box(axes, low - lacking * [0.5, 0.5, 0.0], high + lacking * [0.5, 0.5, 1.0])


def cosine_directions(count: int) -> Float[np.ndarray, "n 3"]:
    """Cosine-distributed directions about +z (Malley's method on a Fibonacci disc)."""
    k = np.arange(count)
    radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - radius**2)], axis=-1)


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
    lobe = cosine_directions(rays)
    rng = np.random.default_rng(seed)
    turns = rng.uniform(0, 2 * np.pi, len(position))
    frames = orthonormal_frame(normal)
    count = len(mesh.faces)
    hits = np.empty((rays, len(position)), np.int32)
    step = max(1, CHUNK // rays)
    for a in StepBar(range(0, len(position), step), "light transport", disable=not progress, unit="block"):
        part = slice(a, min(a + step, len(position)))
        c, s = np.cos(turns[part]), np.sin(turns[part])
        x = lobe[:, 0, None] * c - lobe[:, 1, None] * s
        y = lobe[:, 0, None] * s + lobe[:, 1, None] * c
        f = frames[part]
        d = x[..., None] * f[:, 0] + y[..., None] * f[:, 1] + lobe[:, 2, None, None] * f[:, 2]
        o = np.broadcast_to(position[part] + OFFSET * normal[part], d.shape)
        flat, starts = d.reshape(-1, 3), o.reshape(-1, 3)
        found = caster.cast(starts, flat)
        end = found.face.astype(np.int32)
        missed = np.flatnonzero(end < 0)
        _, patch = box.exits(starts[missed], flat[missed])
        end[missed] = count + patch
        for window in windows:
            end[missed[through(window, starts[missed], flat[missed])]] = count + len(centres)
        hits[:, part] = end.reshape(rays, -1)
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
