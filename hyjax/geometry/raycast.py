"""Ray casting on the host with Embree: mesh + camera → `GBuffer`."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from embreex import mesh_construction, rtcore_scene
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from hyjax.geometry.camera import Camera
from hyjax.light.gbuffer import GBuffer
from hyjax.util.geometry import dot

# A few float32 steps off the ray, towards no axis and no diagonal: 3 µm at a metre.
NUDGE = 3e-6 * np.array([0.61, 0.53, 0.59], dtype=np.float32)

AT_ONCE = 1 << 15
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
    """A mesh in an Embree tree. Built once, asked many times.

    Embree's robust mode is on: its edge tests are watertight, so that rays through a shared edge of two
    triangles never slip between them. Embree computes in float32, so the mesh is moved to its centre first.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        self._centre = mesh.bounds.mean(axis=0)
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        vertices = np.ascontiguousarray(mesh.vertices - self._centre, dtype=np.float32)
        mesh_construction.TriangleMesh(self._scene, vertices, np.ascontiguousarray(mesh.faces, dtype=np.int32))
        corners = np.asarray(mesh.vertex_normals, dtype=np.float32)[mesh.faces]
        faces = np.asarray(mesh.face_normals, dtype=np.float32)
        self._corners = np.concatenate([corners, faces[:, None]], axis=1)  # of each triangle; its own at the end

    def _float32(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        shifted = np.broadcast_to(origins - self._centre, directions.shape)
        return (
            np.ascontiguousarray(shifted, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
        )

    def cast(
        self,
        origins: Float[np.ndarray, "n 3"],
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
            beside_hits = ndimage.binary_dilation(~missed.reshape(grid), np.ones((3, 3), bool)).reshape(-1)
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
        """Embree's answers, asked for by parts: it keeps all of Python waiting meanwhile."""
        parts = [
            self._scene.run(starts[k : k + AT_ONCE], rays[k : k + AT_ONCE], output=True)
            for k in range(0, max(len(rays), 1), AT_ONCE)
        ]
        return {key: np.concatenate([part[key] for part in parts]) for key in ("tfar", "primID", "u", "v")}

    def occluded(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        max_distance: Float[np.ndarray, "n"] | float = 1e37,
    ) -> Bool[np.ndarray, "n"]:
        """Whether anything lies on each ray nearer than `max_distance` (in units of the direction's length)."""
        o, d = self._float32(origins, directions)
        far = np.array(np.broadcast_to(max_distance, len(d)), dtype=np.float32)
        return self._scene.run(o, d, dists=far, query="OCCLUDED") >= 0

    def interpolated_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Unit vertex normals interpolated at the hits; zero for a miss."""
        normal = np.einsum("nk,nkd->nd", hits.barycentric, self._corners[hits.face, :3])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.where(hits.hit[:, None] & (length > 0), normal / np.maximum(length, 1e-20), 0.0)

    def gbuffer(self, camera: Camera) -> GBuffer:
        """G-buffer of the mesh in `camera`. Normals are interpolated from the vertices and face the camera."""
        shape = camera.intrinsics.shape
        rays = camera.rays().astype(np.float32)
        hits = self.cast(camera.origin, rays.reshape(-1, 3), shape)
        normals = self._corners[hits.face].reshape(*shape, 4, 3)  # NumPy gathers rows many times faster than XLA
        grid = (part.reshape(*shape, -1) for part in (hits.distance, hits.barycentric, hits.hit))
        seen = _gbuffer(jnp.asarray(camera.origin, jnp.float32), rays, *grid, normals)
        face = jnp.asarray(hits.face.reshape(shape), jnp.int32)
        barycentric = jnp.asarray(hits.barycentric.reshape(*shape, 3), jnp.float32)
        return dataclasses.replace(seen, face=face, barycentric=barycentric)


@jax.jit
def _gbuffer(
    origin: Float[Array, "3"],
    rays: Float[Array, "h w 3"],
    distance: Float[Array, "h w 1"],
    barycentric: Float[Array, "h w 3"],
    hit: Bool[Array, "h w 1"],
    normals: Float[Array, "h w 4 3"],
) -> GBuffer:
    """From rays of unit depth, where they met the mesh, and the normals of three corners and the triangle there."""
    # Directions have unit depth, so that Embree's ray parameter is the depth itself.
    depth = jnp.where(hit, distance, 0.0)
    position = jnp.where(hit, origin[None, None] + rays * depth, 0.0)
    first, second, third = (barycentric[..., k : k + 1] * normals[..., k, :] for k in range(3))
    normal = first + second + third
    length = jnp.sqrt(dot(normal, normal))[..., None]
    # The triangle decides which side is seen. Near a silhouette an interpolated normal may lean a little away
    # from the camera in all honesty; turned round it would be lit from the wrong side.
    face = normals[..., 3, :]
    turned = (dot(face, rays) > 0) != (dot(face, normal) < 0)
    normal = jnp.where(turned[..., None], -normal, normal)
    normal = jnp.where(hit & (length > 0), normal / jnp.maximum(length, 1e-20), 0.0)
    return GBuffer(position, normal, depth[..., 0], hit[..., 0])
