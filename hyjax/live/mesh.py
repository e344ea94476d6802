"""Mesh in pieces: each piece belongs to a region of blocks, and is made anew only when the region has changed.

A region's cells reach one voxel into the regions after it, so that pieces meet without a gap and together have the
triangles of the whole. Normals are the gradient of the distance, which no seam disturbs.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy import sparse

from hyjax.geometry.surface import zero_crossing
from hyjax.geometry.tsdf import BLOCK_SIDE
from hyjax.geometry.voxels import voxel_coordinates, voxel_keys
from hyjax.live.volume import UNSEEN_VALUE, LiveVolume
from hyjax.util.errors import InputError
from hyjax.util.vectors import SHORTEST_LENGTH, unit

REGION_BLOCKS = 4
"""Blocks along a region's side."""
REGION_VOXELS = REGION_BLOCKS * BLOCK_SIDE
SPECK_AREA = 64.0
"""Square voxels: connected surface of less that ends within its region is dropped, as in `extract_surface`."""
Region = tuple[int, int, int]
PATIENCE = 0.2
"""Growth of a region's urgency each time that others are meshed before it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Surface in a region, in world coordinates."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "n 3"]

    def is_same(self, other: "Piece | None") -> bool:
        """Whether another piece has the same triangles."""
        return (
            other is not None
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.faces, other.faces)
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Cut:
    """Zero crossing in a region, in voxels from its corner.

    Attributes:
        distance: with a voxel before the region and two after it.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    distance: Float[np.ndarray, "x y z"]


class LiveMesh:
    """Pieces of a volume's surface by region.

    Attributes:
        pieces: of the regions that have any surface.
        waiting: regions that have changed and were not meshed yet, with the urgency of each.

    Args:
        clean: whether specks are dropped.
    """

    def __init__(self, volume: LiveVolume, *, clean: bool = True) -> None:
        self._volume, self._clean = volume, clean
        self.pieces: dict[Region, Piece] = {}
        self.waiting: dict[Region, float] = {}

    def renew(self, most: int | None = None) -> tuple[list[Region], list[Region]]:
        """Make pieces anew whose blocks have changed, those that have changed most first.

        Args:
            most: pieces that are made at once; the rest waits for the next time. None for all.

        Returns:
            The regions that were meshed again, and those of them whose surface is another now.
        """
        for region in self.waiting:
            self.waiting[region] += PATIENCE
        for region, amount in amounts_of(*self._volume.take_changes()).items():
            self.waiting[region] = max(self.waiting.get(region, 0.0), amount)
        regions = sorted(self.waiting, key=lambda region: (-self.waiting[region], region))[:most]
        changed: list[Region] = []
        cuts = {region: cut for region in regions if (cut := self._cut(region)) is not None}
        if self._clean:
            cuts = without_specks(cuts, REGION_VOXELS)
        for region in regions:
            del self.waiting[region]
            before = self.pieces.pop(region, None)
            piece = self._piece(region, cuts[region]) if region in cuts else None
            if piece is not None:
                self.pieces[region] = piece
            if not (before is None if piece is None else piece.is_same(before)):
                changed.append(region)
        return regions, changed

    def whole(self) -> trimesh.Trimesh:
        """All pieces as one mesh; vertices on the seams are there twice."""
        return joined([self.pieces[region] for region in sorted(self.pieces)])

    def _cut(self, region: Region) -> "Cut | None":
        low = np.array(region) * REGION_BLOCKS
        box = self._volume.distances(low - 1, np.full(3, REGION_BLOCKS + 2))
        # One voxel before the region and two after it: what gradients at its vertices need.
        start, end = BLOCK_SIDE - 1, BLOCK_SIDE + REGION_VOXELS + 2
        box = box[start:end, start:end, start:end]
        inner = box[1:-1, 1:-1, 1:-1]
        seen = inner < UNSEEN_VALUE
        if not (inner < 0).any() or not ((inner > 0) & seen).any():
            return None
        try:
            vertices, faces = zero_crossing(np.where(seen, inner, np.float32(1.0)), seen.copy())
        except InputError:
            return None
        return Cut(vertices, faces, box)

    def _piece(self, region: Region, cut: "Cut") -> Piece:
        normals = gradient_normals(cut.distance, cut.vertices + 1.0)
        first = np.array(region) * float(REGION_VOXELS)
        world = ((cut.vertices + first) * self._volume.voxel).astype(np.float32)
        return Piece(world, np.ascontiguousarray(cut.faces, np.int32), normals)


def amounts_of(blocks: Int[np.ndarray, "n 3"], amounts: Float[np.ndarray, "n"]) -> dict[Region, float]:
    """Regions with a cell that has a corner in any of these blocks, and the largest amount of theirs."""
    corners = np.indices((2, 2, 2)).reshape(3, 8).T
    touched = voxel_keys((blocks[:, None] - corners[None]).reshape(-1, 3) // REGION_BLOCKS)
    keys, place = np.unique(touched, return_inverse=True)
    largest = np.zeros(len(keys))
    np.maximum.at(largest, place.reshape(-1), np.repeat(amounts, len(corners)))
    return {(x, y, z): float(a) for (x, y, z), a in zip(voxel_coordinates(keys).tolist(), largest)}


def joined(pieces: Sequence[Piece]) -> trimesh.Trimesh:
    """Pieces one after the other as one mesh."""
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    empty = np.zeros((0, 3), np.float32)
    return trimesh.Trimesh(
        np.concatenate([empty, *(piece.vertices for piece in pieces)]),
        np.concatenate([empty.astype(np.int64), *(p.faces + s for p, s in zip(pieces, starts))]),
        vertex_normals=np.concatenate([empty, *(piece.normals for piece in pieces)]),
        process=False,
    )


def gradient_normals(
    distance: Float[np.ndarray, "x y z"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit gradient of the distance at vertices on the edges of its grid, one voxel within it at least.

    Differences are central, and one-sided beside voxels that are `UNSEEN_VALUE`.
    """
    first = np.floor(points).astype(np.int64)
    part = points - first
    along = part.argmax(axis=1)
    share = part[np.arange(len(points)), along].astype(np.float32)[:, None]
    second = first.copy()
    second[np.arange(len(points)), along] += share[:, 0] > 0
    flat, steps = distance.reshape(-1), np.array([distance.shape[1] * distance.shape[2], distance.shape[2], 1])
    ends = [_gradient(flat, end @ steps, steps) for end in (first, second)]
    return unit(ends[0] + share * (ends[1] - ends[0]), SHORTEST_LENGTH).astype(np.float32)


def _gradient(
    flat: Float[np.ndarray, "v"], index: Int[np.ndarray, "n"], steps: Int[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    here = flat[index]
    parts = []
    for step in steps:
        after, before = flat[index + step], flat[index - step]
        after, before = np.where(after < UNSEEN_VALUE, after, here), np.where(before < UNSEEN_VALUE, before, here)
        parts.append(after - before)
    return np.stack(parts, axis=-1)


def without_specks(cuts: Mapping[Region, Cut], side: int) -> dict[Region, Cut]:
    """Cuts without their connected parts that are small and end within their region, and without empty ones."""
    if not cuts:
        return {}
    # All at once: one graph of many pieces is looked through much sooner than many graphs.
    starts = np.cumsum([0] + [len(cut.vertices) for cut in cuts.values()])
    vertices = np.concatenate([cut.vertices for cut in cuts.values()])
    faces = np.concatenate([cut.faces + start for cut, start in zip(cuts.values(), starts)])
    kept = _without_specks(vertices, faces, side)
    found = {}
    for (region, cut), start, end in zip(cuts.items(), starts[:-1], starts[1:], strict=True):
        here = kept[start:end]
        if here.all():
            found[region] = cut
        elif here.any():
            renumbered = np.cumsum(here) - 1
            left = renumbered[cut.faces[here[cut.faces[:, 0]]]]
            found[region] = dataclasses.replace(cut, vertices=cut.vertices[here], faces=left)
    return found


def _without_specks(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], side: int
) -> Bool[np.ndarray, "n"]:
    count = len(vertices)
    start, end = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    graph = sparse.coo_array((np.ones(len(start), bool), (start, end)), shape=(count, count))
    number, part = sparse.csgraph.connected_components(graph, directed=False)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(part[faces[:, 0]], 0.5 * np.linalg.norm(cross, axis=1), minlength=number)
    on_border = np.any((vertices <= 0.0) | (vertices >= side), axis=1)
    outside = np.bincount(part, on_border, minlength=number) > 0
    return np.asarray((outside | (area >= SPECK_AREA))[part])
