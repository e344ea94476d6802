"""Unorganised points, as laser scanners measure them → small oriented discs that cover the surface.

A point's normal is the direction in which its neighbours spread least. Its sign means nothing: which side is seen
is known to a camera only (`hyjax.geometry.splatting`).

Sources: Hoppe et al., "Surface reconstruction from unorganized points", SIGGRAPH 1992 (normals); Breunig et al.,
"LOF: identifying density-based local outliers", SIGMOD 2000 (a point is judged by the density around its
neighbours, since a scanner's density falls with distance).
"""

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from tqdm import tqdm

from hyjax.geometry.voxels import VoxelMean
from hyjax.util.errors import InputError

NEIGHBOURS = 16  # that a normal is made of
COVERING = 6  # a disc reaches to this neighbour; randomly placed discs then leave 1/400 of a surface uncovered
AROUND = 4  # neighbours that a point is compared with
ISOLATED = 3.0  # times as far from its neighbours as they are from theirs: not of the surface
PIECE = 1 << 16  # points that are worked on at once


@dataclasses.dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of surfaces, with what is needed to draw each as a disc.

    Attributes:
        points: in metres, float32.
        normals: unit normals, float32; either side.
        radius: of a disc that reaches to the point's neighbours, metres, float32.
    """

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, "n"]

    def __len__(self) -> int:
        return len(self.points)


def make_point_cloud(
    points: Float[np.ndarray, "n 3"], voxel: float | None = None, progress: bool = True
) -> PointCloud:
    """Thin points out, find their normals and distances, drop isolated ones.

    Args:
        points: in metres.
        voxel: edge in metres of the cells that keep the mean of their points; all points are kept unless given.
        progress: show a bar on stderr.

    Raises:
        InputError: not n points of three finite coordinates, fewer than 17 of them, an unusable voxel.
    """
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"point cloud: need finite points of shape (n, 3), got {points.shape} or non-finite ones")
    if voxel is not None:
        thinner = VoxelMean(voxel)
        thinner.add(points)
        points = thinner.points()
    if len(points) <= NEIGHBOURS:
        at = "" if voxel is None else f" at a voxel of {voxel:g} m"
        raise InputError(f"point cloud: {len(points)} points{at} make no surface; need at least {NEIGHBOURS + 1}")
    points = points.astype(np.float32)
    # Points lie on surfaces, near the median of any box around them: sliding cuts are as good and build faster.
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    normals, radius = np.empty_like(points), np.empty(len(points), np.float32)
    nearest = np.empty((len(points), AROUND), np.int32)

    def measure(start: int) -> int:
        piece = slice(start, start + PIECE)
        normals[piece], radius[piece], nearest[piece] = _neighbourhood(tree, piece)
        return len(radius[piece])

    with (
        ThreadPoolExecutor(os.cpu_count()) as pool,
        tqdm(
            desc="point cloud: normals", total=len(points), unit="point", unit_scale=True, disable=not progress
        ) as bar,
    ):
        for count in pool.map(measure, range(0, len(points), PIECE)):
            bar.update(count)
    kept = radius <= ISOLATED * np.median(radius[nearest], axis=1)
    return PointCloud(points[kept], normals[kept], radius[kept])


def _neighbourhood(
    tree: cKDTree, piece: slice
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], Int[np.ndarray, "n 4"]]:
    """Normals of the points `piece`, distances to their sixth neighbours, their four nearest neighbours."""
    distance, index = tree.query(tree.data[piece], NEIGHBOURS + 1)
    around = tree.data[index]
    around = around - around.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(around.transpose(0, 2, 1) @ around)  # by increasing spread
    return axes[:, :, 0], distance[:, COVERING], index[:, 1 : AROUND + 1]
