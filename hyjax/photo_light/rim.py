"""Rim of a scan: its light is held to that of the surface nearby.

Half of what a vertex at the rim sees was not scanned. The patches of the box stand in for it, some of them
centimetres away, so that the fitted light rises or falls along the rim by more than any real light does.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from hyjax.geometry.mesh_arrays import edges_of

RIM_WIDTH = 0.06
"""Distance from an open edge, in metres, up to which a vertex belongs to the rim."""
NEAREST, FARTHEST = 4, 0.3
"""Number of vertices beyond the rim that hold one of it, and their largest distance in metres; a difference of 1
between normals counts as much, since surfaces that face elsewhere have another light."""
SLACK = 0.1
"""Difference of logarithms that is left to a vertex of the rim beyond their range."""


def rim_of(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, "v"]:
    """Vertices at open edges of the surface, and those near them."""
    from scipy.spatial import cKDTree  # SciPy is slow to load

    edges, count = edges_of(faces)
    rim = np.zeros(len(vertices), bool)
    rim[edges[count == 1]] = True
    if rim.any():
        rim |= cKDTree(vertices[rim]).query(vertices, distance_upper_bound=RIM_WIDTH)[0] <= RIM_WIDTH
    return rim


def held_at_rim(
    light: Float[np.ndarray, "v c"],
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, "v c"]:
    """Light of the vertices, at the rim within the range of the nearest vertices beyond it that face the same way.

    Args:
        light: positive.
        vertices, normals, faces: of the scan; what hangs together by nothing but rim keeps its light.
    """
    from scipy.spatial import cKDTree

    rim = rim_of(vertices, faces)
    if not rim.any() or (~rim).sum() < NEAREST:
        return light
    places = np.concatenate([vertices, FARTHEST * normals], axis=1)
    distance, nearest = cKDTree(places[~rim]).query(places[rim], k=NEAREST, distance_upper_bound=FARTHEST)
    found = np.isfinite(distance)
    known = np.concatenate([np.log(light[~rim]), np.full((1, light.shape[1]), np.nan)])[nearest]
    low = np.where(found[..., None], known, np.inf).min(axis=1) - SLACK
    high = np.where(found[..., None], known, -np.inf).max(axis=1) + SLACK
    held, any_found = light.copy(), found.any(axis=1, keepdims=True)
    held[rim] = np.where(any_found, np.exp(np.clip(np.log(light[rim]), low, high)), light[rim])
    return held
