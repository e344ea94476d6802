"""Clean mesh of a sparse signed distance: marching cubes, small pieces removed, smooth normals."""

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy import sparse
from skimage.measure import marching_cubes

from hyjax.geometry.mesh import degenerate_faces, submesh
from hyjax.util.errors import InputError
from hyjax.util.vectors import SHORTEST_LENGTH, unit

MAX_VOXELS = 400_000_000  # of the dense box for marching cubes: 1.6 GB of distances, 0.4 GB of mask
# Distances nearer to zero than this share of the truncation are moved off it: a vertex exactly on a grid point
# is one vertex several times over, with triangles of no area between its copies.
OFF_ZERO = 2e-3
NORMAL_SMOOTHING = 3  # passes


def extract_surface(
    blocks: Int[np.ndarray, "n 3"],
    distance: Float[np.ndarray, "n 512"],
    observed: Bool[np.ndarray, "n 512"],
    voxel: float,
) -> trimesh.Trimesh:
    """Zero crossing of a signed distance, where all eight corners of a cell were observed.

    Connected pieces of less surface than (8 voxels)² are dropped.

    Args:
        blocks: coordinates of blocks of 8³ voxels; voxel (i, j, k) of block b sits at voxel·(8b + (i, j, k)).
        distance: signed, positive in free space, as a share of the truncation.
        voxel: edge in metres.

    Returns:
        Mesh without degenerate triangles, wound so that its normals point into free space.
    """
    solid = ((distance < 0) & observed).any(axis=1)
    if not solid.any():
        raise InputError("no surface: no voxel was measured from in front and behind; need more or nearer depth")
    low, high = blocks[solid].min(axis=0) - 1, blocks[solid].max(axis=0) + 2
    inside = ((blocks >= low) & (blocks < high)).all(axis=1)
    volume, mask = _assemble(blocks[inside] - low, distance[inside], observed[inside], high - low)
    vertices, faces = zero_crossing(volume, mask)
    # PLY and GLB hold float32: round now, so that what is checked here is what will be read back.
    vertices = ((vertices + low * 8.0) * voxel).astype(np.float32)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    bad = degenerate_faces(vertices, faces)
    bad |= in_small_pieces(mesh, (8.0 * voxel) ** 2)
    if bad.all():
        raise InputError("no surface: only specks were measured; need more depth or a finer voxel")
    return with_normals(submesh(mesh, ~bad), NORMAL_SMOOTHING)


def _assemble(
    blocks: Int[np.ndarray, "n 3"],
    distance: Float[np.ndarray, "n 512"],
    observed: Bool[np.ndarray, "n 512"],
    size: Int[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "x y z"], Bool[np.ndarray, "x y z"]]:
    """Blocks → dense arrays."""
    if np.prod(size.astype(float)) * 512 > MAX_VOXELS:
        extent = "x".join(str(8 * n) for n in size)
        raise InputError(
            f"a grid of {extent} voxels does not fit in memory ({MAX_VOXELS:.0e} do); take a coarser voxel"
        )
    volume = np.ones((size[0], 8, size[1], 8, size[2], 8), dtype=np.float32)
    mask = np.zeros(volume.shape, dtype=bool)
    x, y, z = blocks.T
    volume[x, :, y, :, z, :] = distance.reshape(-1, 8, 8, 8)
    mask[x, :, y, :, z, :] = observed.reshape(-1, 8, 8, 8)
    shape = tuple(8 * size)
    return volume.reshape(shape), mask.reshape(shape)


def zero_crossing(
    volume: Float[np.ndarray, "x y z"], mask: Bool[np.ndarray, "x y z"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Vertices (in voxels) and faces of a dense signed distance; both arrays are changed in place.

    Args:
        volume: positive in free space.
        mask: which voxels were observed; a cell counts if all its eight corners were.
    """
    near_zero = np.abs(volume) < OFF_ZERO
    volume[near_zero] = np.where(volume[near_zero] < 0, -OFF_ZERO, OFF_ZERO)
    # skimage asks the mask at the far corner of each cell only; make that corner speak for all eight.
    for axis in range(3):
        later, earlier = [slice(None)] * 3, [slice(None)] * 3
        later[axis], earlier[axis] = slice(1, None), slice(None, -1)
        mask[tuple(later)] = mask[tuple(later)] & mask[tuple(earlier)]
    try:
        vertices, faces, _, _ = marching_cubes(volume, 0.0, mask=mask, gradient_direction="descent")
    except (RuntimeError, ValueError) as error:  # skimage's two ways of saying that nothing crosses zero
        raise InputError("no surface: no voxel was measured from in front and behind; need more depth") from error
    return vertices, faces


def in_small_pieces(mesh: trimesh.Trimesh, min_area: float) -> Bool[np.ndarray, "m"]:
    """Mask of the faces that belong to a connected piece of less than `min_area`."""
    faces = np.asarray(mesh.faces)
    graph = _adjacency(faces, len(mesh.vertices))
    piece = sparse.csgraph.connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.bincount(piece, weights=mesh.area_faces)[piece] < min_area


def smooth_normals(mesh: trimesh.Trimesh, passes: int) -> Float[np.ndarray, "n 3"]:
    """Area-weighted vertex normals, averaged with their neighbours' `passes` times."""
    faces = np.asarray(mesh.faces)
    cross = np.asarray(mesh.triangles_cross)
    incidence = sparse.csr_array(
        (np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))),
        shape=(len(mesh.vertices), len(faces)),
    )
    normals = unit(incidence @ cross, SHORTEST_LENGTH)
    around = _adjacency(faces, len(mesh.vertices)) + sparse.eye_array(len(mesh.vertices))
    for _ in range(passes):
        normals = unit(around @ normals, SHORTEST_LENGTH)
    return normals


def with_normals(mesh: trimesh.Trimesh, passes: int) -> trimesh.Trimesh:
    """The mesh with vertex normals smoothed so many times."""
    normals = smooth_normals(mesh, passes)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)


def relax(mesh: trimesh.Trimesh, passes: int) -> trimesh.Trimesh:
    """The mesh with its vertices moved half-way to their neighbours' mean, `passes` times; rounds it off."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    around = _adjacency(faces, len(vertices))
    count = np.maximum(around.sum(axis=1), 1.0)[:, None]
    for _ in range(passes):
        vertices = 0.5 * (vertices + around @ vertices / count)
    return trimesh.Trimesh(vertices, faces, process=False)


def _adjacency(faces: Int[np.ndarray, "m 3"], count: int) -> sparse.csr_array:
    """Adjacency matrix of the vertices; the entries count the faces at each edge."""
    start, end = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    one_way = sparse.csr_array((np.ones(len(start)), (start, end)), shape=(count, count))
    return one_way + one_way.T
