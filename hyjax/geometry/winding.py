"""Winding of a mesh's triangles: the order of the vertices, by which normals point to the front or to the back."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from hyjax.geometry.camera import Camera
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.raycast import RayCaster

ROWS = 48
"""Rays of a camera, from top to bottom."""
FEWEST_VOTES, LEAST_MAJORITY = 20, 0.5
"""Fewest rays that must meet a part, and their majority by which it is turned, as a share: thin things, such as a
leaf's two sides, are seen from both."""
FEWEST_BACKS = 0.005
"""Share of all rays that meet a back, up to which there is nothing to turn."""


def turned_away(caster: RayCaster, cameras: Sequence[Camera]) -> Bool[np.ndarray, "m"]:
    """Triangles of the parts of a mesh whose back is what cameras see.

    A part is what hangs together with one winding: its triangles that no ray meets follow the others.

    Args:
        cameras: of the frames, some of them.
    """
    faces, normals = caster.arrays.faces, caster.arrays.face_normals
    fronts, backs = np.zeros(len(faces)), np.zeros(len(faces))
    for camera in cameras:
        size = camera.intrinsics
        small = Camera(size.resize(ROWS, max(1, round(ROWS * size.width / size.height))), camera.pose)
        rays = small.rays().reshape(-1, 3)
        hits = caster.cast(camera.origin, rays)
        met = np.flatnonzero(hits.hit)
        behind = np.einsum("nk,nk->n", normals[hits.face[met]], rays[met]) > 0
        backs += np.bincount(hits.face[met[behind]], minlength=len(faces))
        fronts += np.bincount(hits.face[met[~behind]], minlength=len(faces))
    if backs.sum() <= FEWEST_BACKS * (fronts.sum() + backs.sum()):
        return np.zeros(len(faces), bool)
    # By place: a textured mesh has a vertex for each of its charts there.
    place = np.unique(caster.arrays.vertices, axis=0, return_inverse=True)[1].reshape(-1)
    parts = _parts(place[faces], len(place))
    front, back = (np.bincount(parts, votes) for votes in (fronts, backs))
    away: np.ndarray = (front + back >= FEWEST_VOTES) & (back - front > LEAST_MAJORITY * (front + back))
    chosen: np.ndarray = away[parts]
    return chosen


def turned(mesh: MeshArrays, chosen: Bool[np.ndarray, "m"]) -> MeshArrays:
    """Mesh with some triangles wound the other way, and its normals on the side of the winding."""
    made = MeshArrays(mesh.vertices, np.where(chosen[:, None], mesh.faces[:, [0, 2, 1]], mesh.faces))
    away = np.einsum("nk,nk->n", made.vertex_normals, mesh.vertex_normals) < 0
    return MeshArrays(made.vertices, made.faces, np.where(away[:, None], -1.0, 1.0) * mesh.vertex_normals)


def _parts(faces: Int[np.ndarray, "m 3"], count: int) -> Int[np.ndarray, "m"]:
    """Number of each triangle's part: neighbours pass their common edge in opposite directions."""
    from scipy.sparse import coo_array  # SciPy is slow to load
    from scipy.sparse.csgraph import connected_components

    start, end = (faces[:, order].reshape(-1).astype(np.int64) for order in ([0, 1, 2], [1, 2, 0]))
    face = np.repeat(np.arange(len(faces)), 3)
    there, back = start * count + end, end * count + start
    order = np.argsort(there, kind="stable")
    place = np.minimum(np.searchsorted(there[order], back), len(order) - 1)
    meets = there[order][place] == back
    pairs = face[meets], face[order][place][meets]
    links = coo_array((np.ones(len(pairs[0]), bool), pairs), shape=(len(faces), len(faces)))
    labels: np.ndarray = connected_components(links, directed=False)[1]
    return labels
