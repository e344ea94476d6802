"""Arrays of a scene for the shaders."""

import dataclasses

import numpy as np
import trimesh
from jaxtyping import Float, Int

from hyjax.device.frame_program import LEAF_TRIANGLES, SceneCounts
from hyjax.light.photo_light import PhotoLight, SurfaceLight
from hyjax.scene.scene import Scene


@dataclasses.dataclass(frozen=True)
class SceneArrays:
    """Arrays of a scene for a device.

    Attributes:
        vertices: of the mesh that casts shadows.
        occluders: its triangles, in the order of their tree.
        fields: position, normal, photo's light and albedo of each point of the light transport, vertices first.
        hits: radiator at the end of each ray of each point.
        sources: share of each source in the photo's light.
        mean: of the photo's light, see `PhotoLight.mean`.
    """

    counts: SceneCounts
    vertices: Float[np.ndarray, "v 3"]
    occluders: Int[np.ndarray, "o 3"]
    faces: Int[np.ndarray, "f 3"]
    fields: Float[np.ndarray, "p 4 4"]
    hits: Int[np.ndarray, "r p"]
    sources: Float[np.ndarray, "s w 3"]
    mean: Float[np.ndarray, "3"]

    def uploads(self) -> dict[str, np.ndarray]:
        """Content of the program's buffers."""
        return {
            "vertices": self.vertices.astype(np.float32),
            "occluders": self.occluders.astype(np.uint32),
            "faces": self.faces.astype(np.uint32),
            "fields": self.fields.astype(np.float32),
            "hits": self.hits.astype(np.uint32),
            "sources": self.sources.astype(np.float32),
        }


def scene_arrays(
    scene: Scene,
    *,
    keep_photo_light: bool = False,
    rays: int | None = None,
    surface_occluders: bool = False,
    photo_exponent: float = 1.0,
) -> SceneArrays:
    """Arrays of a scene.

    Args:
        keep_photo_light: whether the light of the photos stays in the pictures, and bounces are left out.
        rays: of each point, evenly chosen among those of the light transport; all by default.
        photo_exponent: of E_old / K, see `hyjax.configuration.LightOptions`.
    """
    mesh = scene.mesh
    photo = None if keep_photo_light else scene.photo_light.estimate.light
    if photo is not None and photo_exponent != 1.0:
        light = SurfaceLight(photo.illuminance, None, photo.transport.faces, kept=photo.sources)
        light = light.raised(photo_exponent)
        assert light.kept is not None
        photo = dataclasses.replace(photo, illuminance=light.photo_light, sources=light.kept)
    fields, hits, sources, mean = _even(mesh) if photo is None else _photo(mesh, photo, rays)
    thrower = mesh if surface_occluders else scene.occluders.mesh
    occluders = tree_order(np.asarray(thrower.vertices, np.float32), np.asarray(thrower.faces))
    counts = SceneCounts(
        len(mesh.faces),
        len(mesh.vertices),
        len(fields),
        len(hits),
        len(sources),
        len(occluders),
        len(thrower.vertices),
    )
    vertices, faces = np.asarray(thrower.vertices), np.asarray(mesh.faces)
    return SceneArrays(counts, vertices, occluders, faces, fields, hits, sources, mean)


def _photo(mesh: trimesh.Trimesh, photo: PhotoLight, rays: int | None) -> tuple[np.ndarray, ...]:
    transport, count = photo.transport, photo.transport.vertices
    position, normal = np.asarray(transport.position), np.asarray(transport.normal)
    fields = np.zeros((len(position), 4, 4), np.float32)
    fields[:, 0, :3], fields[:, 1, :3], fields[:, 3, :3] = position, normal, np.asarray(photo.albedo)
    fields[:count, 1, :3] = np.asarray(mesh.vertex_normals)
    fields[:count, 2, :3] = np.asarray(photo.illuminance)
    hits = np.asarray(transport.hits)
    if rays is not None and rays < len(hits):
        hits = hits[(np.arange(rays) * len(hits)) // rays]
    return fields, hits, np.asarray(photo.sources), np.asarray(photo.mean)


def _even(mesh: trimesh.Trimesh) -> tuple[np.ndarray, ...]:
    """Even light on a mesh without interreflections."""
    fields = np.zeros((len(mesh.vertices), 4, 4), np.float32)
    fields[:, 0, :3], fields[:, 1, :3], fields[:, 2, :3] = mesh.vertices, mesh.vertex_normals, 1.0
    return (
        fields,
        np.zeros((1, len(fields)), np.int32),
        np.zeros((0, len(fields), 3), np.float32),
        np.ones(3, np.float32),
    )


def tree_order(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """Order of triangles in a complete tree, split at the median of the longest side of each part.

    All leaves but the last ones have `LEAF_TRIANGLES` triangles, so that the tree needs no pointers.

    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [9, 0, 0], [9, 1, 0]])
    >>> tree_order(corners, np.array([[1, 2, 3], [0, 1, 2]])).tolist()
    [[1, 2, 3], [0, 1, 2]]
    """
    leaves = 1 << max(0, (-(-len(faces) // LEAF_TRIANGLES) - 1).bit_length())
    middle = vertices[faces].mean(axis=1)
    order = np.arange(leaves * LEAF_TRIANGLES)  # what is beyond the last triangle sorts to the end of every part
    far = len(faces)
    parts = 1
    while parts < leaves:
        grid = order.reshape(parts, -1)
        known = grid < far
        place = np.where(known[..., None], middle[np.minimum(grid, far - 1)], np.nan)
        with np.errstate(invalid="ignore"):
            extent = np.nan_to_num(_span(place))
        axis = np.argmax(extent, axis=1)
        key = np.take_along_axis(place, axis[:, None, None], axis=2)[..., 0]
        key = np.where(known, key, np.inf)
        order = np.take_along_axis(grid, np.argsort(key, axis=1, kind="stable"), axis=1).reshape(-1)
        parts *= 2
    return faces[order[order < far]]


def _span(place: Float[np.ndarray, "n m 3"]) -> Float[np.ndarray, "n 3"]:
    """Extent of each part along each axis; NaN counts as nothing."""
    low = np.where(np.isnan(place), np.inf, place).min(axis=1)
    high = np.where(np.isnan(place), -np.inf, place).max(axis=1)
    return np.where(high >= low, high - low, 0.0)
