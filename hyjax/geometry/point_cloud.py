"""Point clouds, as laser scanners measure them → a mesh of small discs that cover the surface.

A point's normal is the direction in which its neighbours spread least. Its sign means nothing: a G-buffer's normals
face the camera anyway.

Sources: Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992 (normals); Breunig et al.,
"LOF: identifying density-based local outliers", SIGMOD 2000 (a point is judged by the density around its
neighbours, since a scanner's density falls with distance).
"""

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree
from tqdm import tqdm

from hyjax.geometry.voxels import REACH, voxel_keys
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.vectors import SHORTEST_LENGTH, unit

NEIGHBOURS = 16  # that a normal is made of
COVERING_NEIGHBOUR = 6
"""Neighbour that a disc reaches to; randomly placed discs then leave 1/400 of a surface uncovered."""
COMPARED_NEIGHBOURS = 4  # neighbours that a point is compared with
ISOLATED_RATIO = 3.0  # times as far from its neighbours as they are from theirs: not of the surface
CHUNK_POINTS = 1 << 18  # points that are worked on at once
CORNERS = np.sqrt(np.pi) / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
"""Corners of a square as large as the unit disc, which takes two triangles."""


@checked_arguments
def disc_mesh(
    points: Float[np.ndarray, "n 3"], voxel: float | None = None, progress: bool = True
) -> trimesh.Trimesh:
    """Mesh of a square for each point of a surface, as large as a disc that reaches to the point's neighbours.

    It can be asked for pictures and shadows as any mesh can. Isolated points are left out.

    Args:
        points: in metres, 17 or more.
        voxel: edge in metres of the cells that points are thinned to, see `thinned`; all are kept unless given.
        progress: show a bar on stderr.

    Raises:
        InputError: not n points of three finite coordinates, fewer than 17 of them, an unusable voxel.
    """
    if not np.isfinite(points).all():
        raise InputError("point cloud: need finite points, some are not")
    points = points if voxel is None else thinned(points, voxel)
    points = points.astype(np.float32)
    different = np.unique(points, axis=0)  # the distance of equal ones is no square's side
    points = points if len(different) == len(points) else different
    if len(points) <= NEIGHBOURS:
        at = "" if voxel is None else f" at a voxel of {voxel:g} m"
        raise InputError(f"point cloud: {len(points)} points{at} make no surface; need at least {NEIGHBOURS + 1}")
    # Points lie on surfaces, near the median of any box around them: sliding cuts are as good and build faster.
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    axes, nearest = np.empty((len(points), 3, 3), np.float32), np.empty((len(points), COVERING_NEIGHBOUR), np.int32)
    radius = np.empty(len(points), np.float32)
    for start in tqdm(range(0, len(points), CHUNK_POINTS), "point cloud", unit="piece", disable=not progress):
        piece = slice(start, start + CHUNK_POINTS)
        distance, index = tree.query(points[piece], NEIGHBOURS + 1, workers=-1)
        around = tree.data[index]
        around = around - around.mean(axis=1, keepdims=True)
        axes[piece] = np.linalg.eigh(around.transpose(0, 2, 1) @ around)[1].transpose(0, 2, 1)  # least spread first
        radius[piece], nearest[piece] = distance[:, COVERING_NEIGHBOUR], index[:, 1 : COVERING_NEIGHBOUR + 1]
    kept = np.flatnonzero(radius <= ISOLATED_RATIO * np.median(radius[nearest[:, :COMPARED_NEIGHBOURS]], axis=1))
    normal = axes[:, 0]
    beside = normal[nearest[kept]]
    side = np.sign(np.einsum("nd,nkd->nk", normal[kept], beside))
    normals = unit(normal[kept] + np.einsum("nk,nkd->nd", side, beside), SHORTEST_LENGTH)
    arms = radius[kept, None, None] * (CORNERS @ axes[kept, 1:])
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(kept))[:, None, None]
    vertices = (points[kept, None] + arms).reshape(-1, 3)
    return trimesh.Trimesh(
        vertices, faces.reshape(-1, 3), vertex_normals=np.repeat(normals, 4, axis=0), process=False
    )


def thinned(points: Float[np.ndarray, "n 3"], voxel: float) -> Float[np.ndarray, "m 3"]:
    """Mean of the points in each cell of a grid, in the order of the cells.

    Args:
        points: finite, metres.
        voxel: edge of a cell, metres.
    """
    if not (voxel > 0 and np.isfinite(voxel)):
        raise InputError(f"voxel: must be > 0 metres, got {voxel:g}")
    scaled = points.astype(np.float64) / voxel
    if np.abs(scaled).max(initial=0) >= REACH:
        raise InputError(
            f"points reach {np.abs(points).max():.3g} m from the origin; with voxels of {voxel:g} m they may reach "
            f"{REACH * voxel:.3g} m; are they in metres?"
        )
    _, cell, count = np.unique(voxel_keys(np.floor(scaled)), return_inverse=True, return_counts=True)
    return np.stack([np.bincount(cell, axis) / count for axis in points.T], axis=-1)
