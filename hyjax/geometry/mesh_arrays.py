"""Arrays of a mesh, which become a `trimesh.Trimesh` when someone needs one: trimesh is slow to load."""

import functools
import hashlib
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from hyjax.util.errors import InputError, shown
from hyjax.util.vectors import SHORTEST_LENGTH, unit

if TYPE_CHECKING:
    import trimesh

    from hyjax.util.cache import Arrays


class MeshArrays:
    """Vertices, triangles and vertex normals of a mesh.

    Args:
        vertices: world metres.
        normals: of the vertices, any length; None to compute them when they are asked for.
    """

    def __init__(
        self,
        vertices: Float[np.ndarray, "n 3"],
        faces: Int[np.ndarray, "m 3"],
        normals: Float[np.ndarray, "n 3"] | None = None,
    ) -> None:
        self.vertices = np.ascontiguousarray(vertices, np.float64)
        self.faces = np.ascontiguousarray(faces, np.int64)
        self._normals = None if normals is None else unit(normals, SHORTEST_LENGTH)

    @classmethod
    def of(cls, mesh: "trimesh.Trimesh | MeshArrays") -> "MeshArrays":
        """Arrays of a mesh, kept as its `mesh`; arrays as they are."""
        if isinstance(mesh, MeshArrays):
            return mesh
        if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
            raise InputError(f"mesh: must be a trimesh.Trimesh, got {shown(mesh)}")
        arrays = cls(mesh.vertices, mesh.faces)
        arrays.mesh = mesh
        return arrays

    @classmethod
    def stored(cls, arrays: "Arrays") -> "MeshArrays":
        """Arrays as `to_store` named them."""
        return cls(arrays["vertices"], arrays["faces"], arrays.get("normals"))

    def to_store(self) -> "dict[str, np.ndarray]":
        """Arrays by name, in single precision and 32 bits."""
        arrays = {"vertices": self.vertices.astype(np.float32), "faces": self.faces.astype(np.int32)}
        return arrays | {"normals": self.vertex_normals.astype(np.float32)}

    @functools.cached_property
    def mesh(self) -> "trimesh.Trimesh":
        """The mesh."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, vertex_normals=self._normals, process=False)

    @property
    def vertex_normals(self) -> Float[np.ndarray, "n 3"]:
        """Unit normals of the vertices."""
        return np.asarray(self.mesh.vertex_normals) if self._normals is None else self._normals

    @functools.cached_property
    def face_normals(self) -> Float[np.ndarray, "m 3"]:
        """Unit normals of the triangles; zero for one without area."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return unit(np.cross(b - a, c - a), SHORTEST_LENGTH)

    @functools.cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and largest coordinates of the vertices that triangles use."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        vertices = self.vertices[used]
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    @functools.cached_property
    def key(self) -> str:
        """Key of vertices and triangles."""
        return hashlib.sha256(self.vertices.tobytes() + self.faces.tobytes()).hexdigest()


def edges_of(faces: Int[np.ndarray, "m 3"]) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "e"]]:
    """Edges of triangles, the lesser vertex first, and how many triangles have each.

    Example:
        >>> edges_of(np.array([[0, 1, 2], [2, 1, 3]]))[1].tolist()
        [1, 1, 2, 1, 1]
    """
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = edges[:, 0] * (int(edges.max(initial=0)) + 1) + edges[:, 1]
    _, first, count = np.unique(keys, return_index=True, return_counts=True)
    return edges[first], count
