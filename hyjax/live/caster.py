"""Ray caster of a mesh in pieces: Embree trees of some pieces each; only those that changed are built anew."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from embreex import mesh_construction, rtcore_scene
from jaxtyping import Bool, Float

from hyjax.geometry.raycast import RayCaster
from hyjax.live.mesh import Piece, Region, joined

FULL = 20_000
"""Triangles of a tree from which it takes no further region. Many small trees are built sooner, but every ray asks
each of them."""
GROWN = 1.5
"""How much larger than that it may grow."""
FAR = np.float32(1e37)
AT_ONCE = 1 << 12
"""Rays that Embree is given at once: meanwhile it keeps all of Python waiting, also the mesh."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Some regions' pieces in an Embree tree.

    Attributes:
        pieces: by region.
        scene: Embree's.
        corners: normals of each triangle's corners, and its own at the end.
    """

    pieces: dict[Region, Piece]
    scene: Any
    corners: Float[np.ndarray, "m 4 3"]

    @classmethod
    def of(cls, pieces: dict[Region, Piece], centre: Float[np.ndarray, "3"]) -> "Tree":
        """Tree of pieces, moved to a centre."""
        ordered = [piece for _, piece in sorted(pieces.items())]
        starts = np.cumsum([0] + [len(piece.vertices) for piece in ordered])
        faces = np.concatenate([piece.faces + np.int32(start) for piece, start in zip(ordered, starts)])
        vertices = np.concatenate([piece.vertices for piece in ordered]) - centre.astype(np.float32)
        scene = rtcore_scene.EmbreeScene(robust=True)
        mesh_construction.TriangleMesh(scene, vertices, faces)
        corner = vertices[faces]
        own = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), np.float32(1e-20))
        normals = np.concatenate([piece.normals for piece in ordered])
        # The first rays would build the tree; now it is done when it is handed on.
        scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), output=True)
        return cls(pieces, scene, np.concatenate([normals[faces], own[:, None]], axis=1))

    @property
    def count(self) -> int:
        """Triangles."""
        return len(self.corners)


class LiveCaster(RayCaster):
    """Pieces of a mesh, to cast rays at; it never changes, and `renewed` makes the next one from it.

    Attributes:
        trees: which together have all pieces.

    Args:
        trees: at least one.
        centre: that they were moved to.
    """

    def __init__(self, trees: tuple[Tree, ...], centre: Float[np.ndarray, "3"]) -> None:
        self.trees, self._centre = trees, centre
        self._corners = np.concatenate([tree.corners for tree in trees])
        self._starts = np.cumsum([0] + [tree.count for tree in trees])

    @classmethod
    def of(cls, pieces: Mapping[Region, Piece], centre: Float[np.ndarray, "3"]) -> "LiveCaster | None":
        """Caster of pieces; None if there are none."""
        return _packed([], dict(pieces), np.asarray(centre, np.float64))

    def renewed(self, pieces: Mapping[Region, Piece]) -> "LiveCaster | None":
        """Caster of other pieces; trees all of whose pieces are still the same are taken over."""
        kept: list[tuple[Tree | None, dict[Region, Piece]]] = []
        placed: set[Region] = set()
        for tree in self.trees:
            now = {region: pieces[region] for region in tree.pieces if region in pieces}
            same = len(now) == len(tree.pieces) and all(now[r] is piece for r, piece in tree.pieces.items())
            kept.append((tree if same else None, now))
            placed |= now.keys()
        new = {region: piece for region, piece in pieces.items() if region not in placed}
        return _packed(kept, new, self._centre)

    @functools.cached_property
    def mesh(self) -> trimesh.Trimesh:  # type: ignore[override]
        """All pieces as one mesh, whose faces are numbered as hits are."""
        pieces = [piece for tree in self.trees for _, piece in sorted(tree.pieces.items())]
        return joined(pieces)

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and largest coordinates."""
        low = np.min([piece.vertices.min(axis=0) for tree in self.trees for piece in tree.pieces.values()], axis=0)
        high = np.max([piece.vertices.max(axis=0) for tree in self.trees for piece in tree.pieces.values()], axis=0)
        return np.stack([low, high])

    def _run(self, starts: Float[np.ndarray, "n 3"], rays: Float[np.ndarray, "n 3"]) -> dict[str, np.ndarray]:
        count = len(rays)
        result = {
            "tfar": np.full(count, FAR),
            "primID": np.full(count, -1, np.int32),
            "u": np.zeros(count, np.float32),
            "v": np.zeros(count, np.float32),
        }
        for first in range(0, count, AT_ONCE):
            part = slice(first, first + AT_ONCE)
            for tree, number in zip(self.trees, self._starts):
                found = tree.scene.run(starts[part], rays[part], dists=result["tfar"][part].copy(), output=True)
                nearer = found["primID"] >= 0
                found["primID"] += np.int32(number)
                for key, values in result.items():
                    np.copyto(values[part], found[key], where=nearer)
        return result

    def occluded(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        max_distance: Float[np.ndarray, "n"] | float = 1e37,
    ) -> Bool[np.ndarray, "n"]:
        """See `RayCaster.occluded`."""
        start, direction = self._float32(origins, directions)
        far = np.array(np.broadcast_to(max_distance, len(direction)), dtype=np.float32)
        hits = [tree.scene.run(start, direction, dists=far.copy(), query="OCCLUDED") >= 0 for tree in self.trees]
        return np.logical_or.reduce(hits)


def _packed(
    kept: list[tuple[Tree | None, dict[Region, Piece]]], new: dict[Region, Piece], centre: Float[np.ndarray, "3"]
) -> LiveCaster | None:
    """Caster of trees that are as they were, or have these pieces now, and of new pieces where there is room."""
    trees: list[Tree | None] = [tree for tree, _ in kept]
    contents = [dict(pieces) for _, pieces in kept]
    sizes = [sum(len(piece.faces) for piece in pieces.values()) for pieces in contents]
    for number, pieces in enumerate(contents):  # trees that have grown too large give of theirs
        while trees[number] is None and sizes[number] > GROWN * FULL and len(pieces) > 1:
            region = max(pieces)
            new[region] = pieces.pop(region)
            sizes[number] -= len(new[region].faces)
    for region in sorted(new):
        size = len(new[region].faces)
        room = [k for k in range(len(sizes)) if sizes[k] + size <= FULL and contents[k]]
        chosen = min(room, key=lambda k: _apart(region, contents[k]), default=None)
        if chosen is None:
            chosen = len(sizes)
            trees.append(None)
            contents.append({})
            sizes.append(0)
        trees[chosen], sizes[chosen] = None, sizes[chosen] + size
        contents[chosen][region] = new[region]
    made = tuple(
        Tree.of(pieces, centre) if tree is None else tree for tree, pieces in zip(trees, contents) if pieces
    )
    return LiveCaster(made, centre) if made else None


def _apart(region: Region, others: Mapping[Region, Piece]) -> float:
    """Distance from a region to the middle of others, in regions: trees are compact, so that few change at once."""
    return float(np.linalg.norm(np.mean(list(others), axis=0) - region))
