"""Furniture in a scanned room, found from a point on it; and ray casting at a room whose pieces have moved.

A scan is one surface: floor, walls and furniture hang together. Without its shell (floor, ceiling, outer walls) it
falls apart into pieces.
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Bool, Float, Int

from hyjax.geometry.camera import Camera
from hyjax.geometry.rasterizer import RasterView
from hyjax.geometry.raycast import Hits, RayCaster
from hyjax.geometry.transport_rays import wall_axes
from hyjax.light.gbuffer import GBuffer

SHELL_THICKNESS = 0.07
"""Largest distance, in metres, of floor, ceiling and outer walls from their planes; up to twice that by binning."""
OUTSIDE_SHARE = 0.05
"""Share of a room's surface that may lie outside of a wall, a floor or a ceiling, as scans are no better."""
LARGEST_PIECE = 2.5
"""Largest piece of furniture, metres; larger connected parts are cut to a box around the point."""
BOX_REACH = 0.7
"""Metres from the point to the sides of that box."""


@dataclasses.dataclass(frozen=True, eq=False)
class Plane:
    """Plane of a floor, a ceiling or an outer wall.

    Attributes:
        normal: unit, into the room.
        place: along it.
        outer: place that surface of it does not exceed by more than `SHELL_THICKNESS`.
    """

    normal: Float[np.ndarray, "3"]
    place: float
    outer: float


def piece_at(
    mesh: trimesh.Trimesh, point: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "m"] | None:
    """The faces of the piece of furniture nearest to a point; None if the point lies on the room itself."""
    centres = mesh.triangles_center
    loose = ~shell(mesh, up)
    distance = np.linalg.norm(centres - np.asarray(point), axis=1)
    seed = int(np.argmin(distance))
    if not loose[seed]:
        near = loose & (distance < SHELL_THICKNESS)
        if not near.any():
            return None
        seed = int(np.flatnonzero(near)[np.argmin(distance[near])])
    pairs = mesh.face_adjacency[loose[mesh.face_adjacency].all(axis=1)]
    label = trimesh.graph.connected_component_labels(pairs, node_count=len(mesh.faces))
    piece = (label == label[seed]) & loose
    if np.ptp(mesh.vertices[mesh.faces[piece].reshape(-1)], axis=0).max() > LARGEST_PIECE:
        piece &= (np.abs(centres - np.asarray(point)) < BOX_REACH).all(axis=1)
    return piece


def shell(mesh: trimesh.Trimesh, up: Float[np.ndarray, "3"]) -> Bool[np.ndarray, "m"]:
    """The faces of floor, ceiling and outer walls, for a room whose walls meet at right angles."""
    centres, found = mesh.triangles_center, np.zeros(len(mesh.faces), bool)
    for plane in shell_planes(mesh, up):
        found |= centres @ plane.normal - plane.outer < SHELL_THICKNESS
    return found


def shell_planes(mesh: trimesh.Trimesh, up: Float[np.ndarray, "3"]) -> list[Plane]:
    """Planes of floor, ceiling and outer walls; not all are always known."""
    normals, areas, centres = mesh.face_normals, mesh.area_faces, mesh.triangles_center
    planes = []
    for axis in wall_axes(mesh, up)[::-1]:
        height = centres @ axis
        across = np.abs(normals @ axis) > 0.9
        if not across.any():
            continue
        bins = np.arange(
            height[across].min() - SHELL_THICKNESS, height[across].max() + 2 * SHELL_THICKNESS, SHELL_THICKNESS
        )
        weight, _ = np.histogram(height[across], bins, weights=areas[across])
        strong = np.flatnonzero(weight > 0.25 * weight.max())
        for first, edge, inward in ((strong[0], strong[0] + 1, axis), (strong[-1], strong[-1], -axis)):
            own = across & (height >= bins[first]) & (height < bins[first + 1])
            place, outer = np.average(centres[own], 0, areas[own]) @ inward, bins[edge] * (inward @ axis)
            # A scan without its ceiling has tables for its highest planes; beyond walls there is next to nothing.
            if areas[centres @ inward - outer < -2 * SHELL_THICKNESS].sum() < OUTSIDE_SHARE * areas.sum():
                planes.append(Plane(inward, float(place), float(outer)))
    return planes


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A rigid part of the room: its surface as it was scanned, and where it is now (4×4).

    `mesh` is the whole room's. Shadows are
    thrown by `occluders`, if there are any, in the surface's place, and looked up with `slack`; `coarse` ones do
    for a draft. `scanned` numbers its triangles among the whole room's; None if it was brought in.
    """

    caster: RayCaster
    pose: Float[np.ndarray, "4 4"]
    mesh: trimesh.Trimesh
    occluders: RayCaster | None = None
    slack: float | None = None
    scanned: Int[np.ndarray, "m"] | None = None
    coarse: RayCaster | None = None

    @property
    def moved(self) -> bool:
        return not np.array_equal(self.pose, np.eye(4))

    def cast(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
        """`RayCaster.cast`, with rays and hits in the room's coordinates."""
        if not self.moved:
            return self.caster.cast(origins, directions)
        turn, shift = self.pose[:3, :3], self.pose[:3, 3]
        return self.caster.cast((origins - shift) @ turn, directions @ turn)

    @property
    def draft(self) -> "Part":
        """The part, whose coarse occluders throw its shadows if it has any."""
        return self if self.coarse is None else dataclasses.replace(self, occluders=self.coarse)

    def distances(self, view: RasterView) -> Float[np.ndarray, "h w"]:
        """`RayCaster.distances` of the caster of this part's shadows."""
        return (self.occluders or self.caster).distances(view.of_moved(self.pose) if self.moved else view)

    def gbuffer(self, camera: Camera) -> GBuffer:
        """Surface points of this part alone that a camera sees; `face` counts the whole room's triangles."""
        if not self.moved:
            return self._numbered(self.caster.gbuffer(camera))
        scanned = self.caster.gbuffer(Camera(camera.intrinsics, np.linalg.inv(self.pose) @ camera.pose))
        return _transform_gbuffer(self._numbered(scanned), jnp.asarray(self.pose, jnp.float32))

    def _numbered(self, gbuffer: GBuffer) -> GBuffer:
        part_face = np.asarray(gbuffer.face)
        face = (
            np.full_like(part_face, -1)
            if self.scanned is None
            else np.where(part_face >= 0, self.scanned[part_face], -1)
        )
        return dataclasses.replace(gbuffer, face=jnp.asarray(face, jnp.int32))

    @property
    def scanned_vertices(self) -> Int[np.ndarray, "v"] | None:
        """Numbers of its vertices among the whole room's; None if it was brought in."""
        if self.scanned is None:
            return None
        numbers = np.zeros(len(self.caster.mesh.vertices), int)
        numbers[self.caster.mesh.faces] = self.mesh.faces[self.scanned]
        return numbers


def cast_parts(
    parts: Sequence[Part], origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """Nearest hits among parts: distance (infinite for a miss), normal of the triangle, number of the part."""
    distances, normals = np.full(len(directions), np.inf), np.zeros((len(directions), 3))
    numbers = np.zeros(len(directions), int)
    for number, part in enumerate(parts):
        hits = part.cast(origins, directions)
        nearer = hits.distance < distances
        faces = part.caster.mesh.face_normals[hits.face[nearer]]
        distances[nearer], numbers[nearer] = hits.distance[nearer], number
        normals[nearer] = np.asarray(faces, float) @ part.pose[:3, :3].T
    return distances, normals, numbers


def merge_gbuffers(parts: list[GBuffer]) -> GBuffer:
    """G-buffer of several parts: pixel by pixel the part in front."""
    return functools.reduce(_nearer_of_two, parts)


@jax.jit
def _transform_gbuffer(gbuffer: GBuffer, pose: Float[Array, "4 4"]) -> GBuffer:
    position = gbuffer.position @ pose[:3, :3].T + pose[:3, 3]
    return dataclasses.replace(
        gbuffer,
        position=jnp.where(gbuffer.hit[..., None], position, 0.0),
        normal=gbuffer.normal @ pose[:3, :3].T,
    )


@jax.jit
def _nearer_of_two(a: GBuffer, b: GBuffer) -> GBuffer:
    first = a.hit & (~b.hit | (a.depth <= b.depth))
    return jax.tree.map(lambda x, y: jnp.where(first[..., None] if x.ndim == 3 else first, x, y), a, b)
