"""Ray casting on meshes by Embree, and G-buffers by the rasteriser, both on the host."""

import dataclasses
import functools
import threading
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from embreex import mesh_construction, rtcore_scene
from jaxtyping import Bool, Float, Int

from hyjax.geometry.camera import Camera
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.rasterizer import Rasterizer, RasterView
from hyjax.light.gbuffer import GBuffer
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    import trimesh

# A few float32 steps off the ray, towards no axis and no diagonal: 3 µm at a metre.
NUDGE = 3e-6 * np.array([0.61, 0.53, 0.59], dtype=np.float32)

RAYS_AT_ONCE = 1 << 15
"""Rays that Embree is given at once: a few milliseconds of them."""


@dataclasses.dataclass(frozen=True)
class Hits:
    """Nearest intersections of n rays.

    Attributes:
        distance: in units of the ray direction's length; infinite for a miss.
        face: index of the triangle, -1 for a miss.
        barycentric: weights of the triangle's three vertices; meaningless for a miss.
    """

    distance: Float[np.ndarray, "n"]
    face: Int[np.ndarray, "n"]
    barycentric: Float[np.ndarray, "n 3"]

    @property
    def hit(self) -> Bool[np.ndarray, "n"]:
        return self.face >= 0


class RayCaster:
    """Caster of rays at a mesh and maker of its G-buffers, from any thread.

    Single rays go to Embree, whose tree is built when the first one comes. Embree's robust mode is on: its edge
    tests are watertight, so that rays through a shared edge of two triangles never slip between them. Embree
    computes in float32, so the mesh is moved to its centre first. Pictures and shadow maps are rasterised.
    """

    def __init__(self, mesh: "trimesh.Trimesh | MeshArrays") -> None:
        self.arrays = MeshArrays.of(mesh)
        self.rasterizer = Rasterizer(self.arrays.vertices, self.arrays.faces)
        if not len(self.arrays.faces):
            raise InputError("mesh: it has no triangles")
        self._centre = self.bounds.mean(axis=0)
        self._lock = threading.Lock()
        self._built: Any = None

    @functools.cached_property
    def mesh(self) -> "trimesh.Trimesh":
        """The mesh."""
        return self.arrays.mesh

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Least and largest coordinates."""
        return self.arrays.bounds

    @property
    def _scene(self) -> Any:
        with self._lock:
            if self._built is None:
                built = rtcore_scene.EmbreeScene(robust=True)
                vertices = (self.rasterizer.vertices - self._centre).astype(np.float32)
                mesh_construction.TriangleMesh(built, vertices, self.rasterizer.triangles)
                self._built = built
            return self._built

    @functools.cached_property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        """Normals of the vertices."""
        return np.ascontiguousarray(self.arrays.vertex_normals, np.float32)

    def _float32(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        shifted = np.broadcast_to(origins - self._centre, directions.shape)
        return (
            np.ascontiguousarray(shifted, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
        )

    @checked_arguments
    def cast(
        self,
        origins: Float[np.ndarray, "o 3"] | Float[np.ndarray, "3"],
        directions: Float[np.ndarray, "n 3"],
        grid: tuple[int, int] | None = None,
    ) -> Hits:
        """Nearest hit of each ray.

        Args:
            origins: may be one point (shape (3,) or (1, 3)) for all directions.
            directions: of any length.
            grid: rows and columns of the picture that the rays belong to, if they do: a miss amid misses is then
                believed at once.
        """
        starts, rays = self._float32(origins, directions)
        result = self._run(starts, rays)
        # Edges are watertight, but a ray aimed exactly at a vertex may slip through: misses get a second try.
        missed = result["primID"] < 0
        if grid is not None:
            hit = np.pad(~missed.reshape(grid), 1)
            columns = hit[:, :-2] | hit[:, 1:-1] | hit[:, 2:]
            beside_hits = (columns[:-2] | columns[1:-1] | columns[2:]).reshape(-1)
            missed &= beside_hits
        again = np.flatnonzero(missed)
        if again.size:
            length = np.linalg.norm(rays[again], axis=1, keepdims=True)
            for key, values in self._run(starts[again], rays[again] + NUDGE * length).items():
                result[key][again] = values
        face = result["primID"]
        u, v = result["u"], result["v"]
        return Hits(
            distance=np.where(face >= 0, result["tfar"], np.inf),
            face=face,
            barycentric=np.stack([1.0 - u - v, u, v], axis=-1),
        )

    def _run(self, starts: Float[np.ndarray, "n 3"], rays: Float[np.ndarray, "n 3"]) -> dict[str, np.ndarray]:
        """Embree's answers, with all that it knows of a hit."""
        parts = self._by_parts(starts, rays, output=True)
        return {key: np.concatenate([part[key] for part in parts]) for key in ("tfar", "primID", "u", "v")}

    def _by_parts(self, starts: np.ndarray, rays: np.ndarray, *, output: bool) -> list[Any]:
        """Embree's answers to parts of the rays: it keeps all of Python waiting meanwhile."""
        parts = [slice(k, k + RAYS_AT_ONCE) for k in range(0, max(len(rays), 1), RAYS_AT_ONCE)]
        return [self._scene.run(starts[part], rays[part], output=output) for part in parts]

    def nearest_faces(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n r 3"]
    ) -> Int[np.ndarray, "n r"]:
        """Triangle that each ray from a point hits first, -1 for none; one in millions may slip through."""
        starts = np.repeat((origins - self._centre).astype(np.float32), directions.shape[1], axis=0)
        rays = np.ascontiguousarray(directions.reshape(-1, 3), np.float32)
        return np.concatenate(self._by_parts(starts, rays, output=False)).reshape(directions.shape[:2])

    @checked_arguments
    def occluded(
        self,
        origins: Float[np.ndarray, "o 3"] | Float[np.ndarray, "3"],
        directions: Float[np.ndarray, "n 3"],
        max_distance: Float[np.ndarray, "n"] | float = 1e37,
    ) -> Bool[np.ndarray, "n"]:
        """Whether anything lies on each ray nearer than `max_distance` (in units of the direction's length)."""
        o, d = self._float32(origins, directions)
        far = np.array(np.broadcast_to(max_distance, len(d)), dtype=np.float32)
        return self._scene.run(o, d, dists=far, query="OCCLUDED") >= 0

    def interpolated_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Unit vertex normals interpolated at the hits; zero for a miss."""
        corners = self.normals[self.rasterizer.triangles[hits.face]]
        normal = np.einsum("nk,nkd->nd", hits.barycentric, corners)
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.where(hits.hit[:, None] & (length > 0), normal / np.maximum(length, 1e-20), 0.0)

    @checked_arguments
    def gbuffer(self, camera: Camera) -> GBuffer:
        """G-buffer of the mesh in `camera`. Normals are interpolated from the vertices and face the camera."""
        return self.rasterizer.gbuffer(camera, self.normals)

    @checked_arguments
    def gbuffer_by_rays(self, camera: Camera) -> GBuffer:
        """`gbuffer` by single rays: sooner there for the first few pictures, as the rasteriser is slow to load."""
        shape, rays = camera.intrinsics.shape, camera.rays().astype(np.float32).reshape(-1, 3)
        hits = self.cast(camera.origin, rays, shape)
        hit, normal = hits.hit, self.interpolated_normals(hits)
        # The triangle decides which side is seen, as near a silhouette an interpolated normal may lean away.
        flat = self.arrays.face_normals[hits.face]
        away = (np.einsum("nk,nk->n", flat, rays) > 0) != (np.einsum("nk,nk->n", flat, normal) < 0)
        depth = np.where(hit, hits.distance, 0.0)
        position = np.where(hit[:, None], camera.origin + depth[:, None] * rays, 0.0)
        weights = np.where(hit[:, None], np.maximum(hits.barycentric, 0.0), 0.0)
        fields = position, np.where(away[:, None], -normal, normal), weights
        points, normals, weights = (field.astype(np.float32).reshape(*shape, 3) for field in fields)
        others = depth.astype(np.float32), hit, hits.face.astype(np.int32)
        planes = (field.reshape(shape) for field in others)
        return GBuffer(*map(jax.device_put, (points, normals, *planes, weights)))

    def distances(self, view: RasterView) -> Float[np.ndarray, "h w"]:
        """Distances of the nearest surface in a view, see `Rasterizer`."""
        return self.rasterizer.distances(view)
