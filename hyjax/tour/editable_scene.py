"""Editable scene: the scanned surface with pieces moved, removed and added as a plan says, and rays cast at it."""

import dataclasses
import functools
from collections.abc import Hashable
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import ArrayLike, Float

from hyjax.geometry.mesh import load_mesh, submesh
from hyjax.geometry.raycast import RayCaster
from hyjax.scene.occluders import complete
from hyjax.tour.furniture import Part, Plane, cast_parts, piece_at, shell_planes
from hyjax.tour.plan import Piece, TourPlan
from hyjax.util.lru_cache import LruCache
from hyjax.util.vectors import perpendicular, unit

PARTS_MIB = 256
"""Memory of parts that were moved lately; where the room is large, that of four rooms."""
FACE_BYTES = 300
"""Memory of a face in a ray caster."""
NEARBY_TANGENTS = (0.0, 0.01, 0.025, 0.05)  # tangents of angles from a ray, tried one after the other


def mebibytes(result: RayCaster | trimesh.Trimesh | np.ndarray | None) -> float:
    """Memory, in MiB, of a part: its ray caster, its mesh or the array of its faces."""
    if isinstance(result, np.ndarray):
        return result.nbytes / 2**20
    mesh = result.arrays if isinstance(result, RayCaster) else result
    return (FACE_BYTES * (1 if mesh is None else 1 + len(mesh.faces))) / 2**20


@dataclasses.dataclass(frozen=True)
class SurfaceHit:
    """Surface point that a ray meets.

    Attributes:
        point: metres, world axes.
        normal: unit, on the side that the ray came from.
        piece: number of the plan's piece; None for the rest of the room.
        origin: where that point was when the room was scanned.
    """

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    piece: int | None
    origin: Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True, eq=False)
class SceneParts:
    """The parts of the room as a plan has them.

    Attributes:
        parts: the rest of the room first.
        keys: revision of the surface, part and pose.
        pieces: the plan's numbers; None for the rest.
    """

    parts: tuple[Part, ...]
    keys: tuple[Hashable, ...]
    pieces: tuple[int | None, ...]


class EditableScene:
    """A surface, and the pieces it falls into.

    Args:
        occluders: what throws the shadows of the room as it was scanned; the surface if None. Once a piece of the
            scan has been taken out, its parts with their holes closed throw them.
        slack: of shadow maps, see `hyjax.light.shadow_map.ShadowMap`; None if the surface throws its own shadows.
        revision: number of the surface: nothing cached of another is taken.
        bounds: least and largest coordinates that shadow maps must cover; the surface's if None.
    """

    def __init__(
        self,
        caster: RayCaster,
        up: Float[np.ndarray, "3"],
        folder: Path,
        occluders: RayCaster | None = None,
        slack: float | None = None,
        *,
        revision: int = 0,
        bounds: Float[np.ndarray, "2 3"] | None = None,
    ) -> None:
        self.revision, self.bounds = revision, caster.bounds if bounds is None else bounds
        self.caster, self.mesh, self.up, self._folder = caster, caster.mesh, up, folder
        self._occluders, self._slack = occluders, slack
        self._parts = LruCache(max(PARTS_MIB, 4 * mebibytes(caster)), mebibytes)

    @functools.cached_property
    def planes(self) -> list[Plane]:
        """Planes of floor, ceiling and outer walls, as they were scanned."""
        return shell_planes(self.mesh, self.up)

    def apply(self, plan: TourPlan) -> SceneParts:
        """The parts that a plan makes of it."""
        scanned = tuple(sorted({piece.seed for piece in plan.pieces if not (piece.file or piece.as_scanned)}))
        masks = [mask for seed in scanned if (mask := self._faces(Piece(seed))) is not None]
        if masks:
            left = ~np.logical_or.reduce(masks)
            rest = self._parts(("rest", scanned), lambda: RayCaster(submesh(self.mesh, left)))
        else:
            left, rest, scanned = np.ones(len(self.mesh.faces), bool), self.caster, ()
        thrower = self._thrower(("rest", scanned), rest)
        # What is finer than the scan makes most of the work of a shadow map.
        detailed = self._slack is not None and thrower is not None and thrower is self._occluders
        coarse = self._closed(("rest", scanned), rest) if detailed else None
        parts = [Part(rest, np.eye(4), self.mesh, thrower, self._slack, np.flatnonzero(left), coarse)]
        keys: list[Hashable] = [(self.revision, "rest", scanned)]
        pieces: list[int | None] = [None]
        for number, piece in enumerate(plan.pieces):
            if piece.removed or piece.as_scanned or (mesh := self.piece_mesh(piece)) is None:
                continue
            name = ("piece", piece.seed, piece.file)
            caster = self._parts(("caster", name), functools.partial(RayCaster, mesh))
            faces = None if piece.file else self._faces(piece)
            numbers = None if faces is None else np.flatnonzero(faces)
            parts.append(Part(caster, piece.matrix, self.mesh, self._thrower(name, caster), self._slack, numbers))
            keys.append((self.revision, name, piece.pose))
            pieces.append(number)
        return SceneParts(tuple(parts), tuple(keys), tuple(pieces))

    def _thrower(self, name: Hashable, caster: RayCaster) -> RayCaster | None:
        """Caster of a part's shadows."""
        if self._slack is None or caster is self.caster:
            return self._occluders
        return self._closed(name, caster)

    def _closed(self, name: Hashable, caster: RayCaster) -> RayCaster:
        """The surface of a part, its holes closed."""
        return self._parts(("closed", name), lambda: RayCaster(complete(caster.mesh)))

    def apply_to_mesh(self, plan: TourPlan) -> trimesh.Trimesh:
        """The whole surface as the plan arranges it."""
        moved = []
        for part in self.apply(plan).parts:
            copy = part.caster.mesh.copy(include_cache=True)  # scanned normals, which shade it
            copy.apply_transform(part.pose)
            moved.append(copy)
        whole: trimesh.Trimesh = trimesh.util.concatenate(moved)  # type: ignore[assignment]
        return whole

    def pick(self, plan: TourPlan, origin: ArrayLike, direction: ArrayLike) -> SurfaceHit | None:
        """First surface on a ray, or next to a ray through a hole of the scan; None if there is none."""
        origin, ray, scene = np.asarray(origin, float), unit(direction), self.apply(plan)
        across = unit(perpendicular(ray))
        for tangent in NEARBY_TANGENTS:
            turns = np.linspace(0.0, 2.0 * np.pi, 8 if tangent else 1, endpoint=False)[:, None]
            rays = ray + tangent * (np.cos(turns) * across + np.sin(turns) * np.cross(ray, across))
            distances, normals, numbers = cast_parts(scene.parts, np.broadcast_to(origin, rays.shape), rays)
            for first in np.flatnonzero(np.isfinite(distances))[:1]:
                point, number = origin + distances[first] * rays[first], numbers[first]
                pose, normal = scene.parts[number].pose, face_toward(normals[first], rays[first])
                return SurfaceHit(point, normal, scene.pieces[number], (point - pose[:3, 3]) @ pose[:3, :3])
        return None

    def visible_surface(
        self, plan: TourPlan, origin: Float[np.ndarray, "3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Points and normals, as in `SurfaceHit`, of the surface that rays from one point meet; m ≤ n."""
        origins = np.broadcast_to(origin, directions.shape)
        distances, normals, _ = cast_parts(self.apply(plan).parts, origins, directions)
        hit = np.isfinite(distances)
        points = origins[hit] + distances[hit, None] * directions[hit]
        return points, face_toward(normals[hit], directions[hit])

    def piece_mesh(self, piece: Piece) -> trimesh.Trimesh | None:
        """The surface of a piece where it was scanned; None if there is nothing at its seed but the room itself."""
        if piece.file:
            return self._parts(("file", piece.file), lambda: self._load_upload(piece.file))
        faces = self._faces(piece)
        if faces is None:
            return None
        return self._parts(("mesh", piece.seed), lambda: submesh(self.mesh, faces))

    def overlapping_piece(self, plan: TourPlan, piece: Piece) -> int | None:
        """The number of the plan's piece that some of a new piece's surface belongs to."""
        faces = self._faces(piece)
        for number, other in enumerate(plan.pieces):
            mask = None if other.file else self._faces(other)
            if faces is not None and mask is not None and bool((faces & mask).any()):
                return number
        return None

    def _faces(self, piece: Piece) -> np.ndarray | None:
        return self._parts(("faces", piece.seed), lambda: piece_at(self.mesh, np.asarray(piece.seed), self.up))

    def _load_upload(self, file: str) -> trimesh.Trimesh:
        mesh = load_mesh(self._folder / file, repair=True)
        if Path(file).suffix == ".glb":  # whose y axis is up, always
            mesh.apply_transform(trimesh.geometry.align_vectors([0.0, 1.0, 0.0], self.up))
        return mesh


def face_toward(
    normals: Float[np.ndarray, "*n 3"], directions: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Normals on the side that rays come from."""
    along = np.einsum("...k,...k->...", normals, directions)
    return np.where(along[..., None] > 0, -normals, normals)
