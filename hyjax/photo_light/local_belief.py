"""Local belief: a divisor that changes only where dividing by the estimate flattens the planes nearby.

An estimate that is right in most of a room is wrong somewhere: on a glossy door, behind a chair whose back was not
scanned. There the pairs of the door itself, which its fit has not seen, come out less flat. The exponent k of the
estimate E that flattens a place most is found at every vertex, and the divisor D follows from its slopes:

    minimise Σ (Δ log D − k Δ log E)² + μ Σ (log D − K log E)²

over the edges and vertices of the scan, with K the exponent that suits the whole scan. Slopes rather than values:
log D itself could not change its exponent without a step.
"""

import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.mesh_arrays import MeshArrays, edges_of
from hyjax.photo_light.belief import EXPONENTS, Belief
from hyjax.util.cores import cores

REACH = 0.4
"""Deviation, in metres, of the weight of a pair around each of its ends."""
NORMAL_REACH = 0.5
"""The same for the difference of unit normals."""
NEAREST = 48
"""Most ends of pairs by which a vertex is judged."""
PRIOR_ENDS = 12.0
"""Weight, in ends of pairs, of the exponent of the whole scan."""
DOUBT = 0.5
"""Least gain in flatness of a place by another exponent, over that of the whole scan by its own."""
SCREEN = 2.0
"""Distance, in metres, over which the divisor returns to that of the whole scan."""
CREASE_COSINE = 0.8
"""Cosine between the normals of neighbours below which no pair judges their edge."""
SMOOTHINGS = 8
"""Number of times that the exponents are averaged with their neighbours'."""
ITERATIONS = 400
"""Most iterations of the solution for the divisor."""
Evidence = tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n e"]] | None
"""Pairs of vertices, and what each fit that left them out leaves of their difference; None without any."""


def local_divisor(
    mesh: MeshArrays,
    normals: Float[np.ndarray, "v 3"],
    log_light: tuple[Float[np.ndarray, "v 1"], Float[np.ndarray, "v 3"]],
    belief: Belief,
    evidence: Evidence,
) -> Float[np.ndarray, "v 3"]:
    """Light that the frames are divided by: the estimate as far as it is believed, here and there."""
    bright, hue = log_light
    if not belief.exponent or evidence is None:
        return np.ones_like(hue)
    own = bright[:, 0] - bright.mean()
    exponents = local_exponents(mesh.vertices, normals, *evidence, belief.exponent)
    even = divisor_log(own, exponents, belief.exponent, mesh.vertices, normals, mesh.faces)
    return np.exp(even[:, None] + belief.hue_exponent * hue)


def local_exponents(
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    pairs: Int[np.ndarray, "n 2"],
    errors: Float[np.ndarray, "n k"],
    exponent: float,
) -> Float[np.ndarray, "v"]:
    """Exponent at each vertex: that of the whole scan unless another flattens its surroundings clearly more.

    Args:
        errors: of each pair for each of `EXPONENTS`, held out from its fit.
    """
    from scipy.spatial import cKDTree  # SciPy is slow to load

    places = np.concatenate([vertices / REACH, normals / NORMAL_REACH], axis=1)
    ends = cKDTree(places[pairs.T.ravel()])
    distance, end = ends.query(places, k=NEAREST, distance_upper_bound=3.0, workers=cores())
    weight = np.where(np.isfinite(distance), np.exp(-0.5 * np.minimum(distance, 9.0) ** 2), 0.0)
    own = np.concatenate([errors, errors, np.zeros((1, errors.shape[1]))])[end]
    total = np.einsum("vn,vnk->vk", weight, own)
    usual = EXPONENTS.index(exponent)
    gain = 1.0 - total.min(axis=1) / np.maximum(total[:, usual], 1e-12)
    whole = 1.0 - errors[:, usual].sum() / max(float(errors[:, 0].sum()), 1e-12)
    found = np.where(gain > DOUBT * whole, np.array(EXPONENTS)[total.argmin(axis=1)], exponent)
    count = weight.sum(axis=1)
    return (count * found + PRIOR_ENDS * exponent) / (count + PRIOR_ENDS)


def divisor_log(
    log_light: Float[np.ndarray, "v"],
    exponents: Float[np.ndarray, "v"],
    exponent: float,
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, "v"]:
    """Logarithm of the divisor.

    Args:
        log_light: log E, with the scan's mean at 0.
    """
    from scipy import sparse
    from scipy.sparse.linalg import cg

    count = len(vertices)
    edges, _ = edges_of(faces)
    edges = edges[edges[:, 0] != edges[:, 1]]
    i, j = edges.T
    ones = np.ones(len(edges))
    beside = sparse.coo_matrix((np.tile(ones, 2), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    degree = np.asarray(beside.sum(axis=1)).ravel()
    even = exponents
    for _ in range(SMOOTHINGS):
        even = np.where(degree > 0, 0.5 * even + 0.5 * (beside @ even) / np.maximum(degree, 1.0), even)
    flat = np.einsum("nk,nk->n", normals[i], normals[j]) > CREASE_COSINE
    slope = np.where(flat, (even[i] + even[j]) / 2, exponent) * (log_light[i] - log_light[j])
    length = float(np.median(np.linalg.norm(vertices[i] - vertices[j], axis=1))) if len(edges) else 1.0
    hold = (length / SCREEN) ** 2
    right = hold * exponent * log_light + np.bincount(i, slope, count) - np.bincount(j, slope, count)
    system = sparse.diags(degree + hold) - beside
    scale = sparse.diags(1.0 / (degree + hold))
    found, _ = cg(system, right, x0=exponent * log_light, rtol=1e-5, maxiter=ITERATIONS, M=scale)
    return np.asarray(found)
