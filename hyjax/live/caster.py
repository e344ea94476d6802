"""Ray caster of a mesh in pieces, made anew with each change: no more is to be done than to put them together."""

import functools
import threading
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.rasterizer import Rasterizer
from hyjax.geometry.raycast import RayCaster
from hyjax.live.mesh import Piece, Region, joined


class LiveCaster(RayCaster):
    """Pieces of a mesh as one.

    Args:
        pieces: by region, at least one; triangles are numbered in the regions' order.
    """

    def __init__(self, pieces: Mapping[Region, Piece]) -> None:
        self._pieces = [piece for _, piece in sorted(pieces.items())]
        starts = np.cumsum([0] + [len(piece.vertices) for piece in self._pieces])
        faces = np.concatenate([piece.faces + np.int32(start) for piece, start in zip(self._pieces, starts)])
        self.rasterizer = Rasterizer(np.concatenate([piece.vertices for piece in self._pieces]), faces)
        self._centre = self.bounds.mean(axis=0)
        self._lock, self._built = threading.Lock(), None

    @functools.cached_property
    def arrays(self) -> MeshArrays:  # type: ignore[override]
        """All pieces as one mesh, whose faces are numbered as hits are."""
        return MeshArrays.of(joined(self._pieces))

    @functools.cached_property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        return np.concatenate([piece.normals for piece in self._pieces])

    @functools.cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and largest coordinates."""
        vertices = self.rasterizer.vertices
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])
