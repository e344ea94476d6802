"""Ray casting on the host with Embree: mesh + camera → `GBuffer`."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import trimesh
from embreex import mesh_construction, rtcore_scene
from jaxtyping import Bool, Float, Int

from hyjax.gbuffer import GBuffer
from hyjax.scene.camera import Camera

# A few float32 steps off the ray, towards no axis and no diagonal: 3 µm at a metre.
NUDGE = 3e-6 * np.array([0.61, 0.53, 0.59], dtype=np.float32)


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
        self._normals = np.asarray(mesh.vertex_normals, dtype=np.float32)
        self._face_normals = np.asarray(mesh.face_normals, dtype=np.float32)
        self._faces = np.asarray(mesh.faces)

    def _float32(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        shifted = np.broadcast_to(origins - self._centre, directions.shape)
        return (
            np.ascontiguousarray(shifted, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
        )

    def cast(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
        """Nearest hit of each ray. `origins` may be one point (shape (3,) or (1, 3)) for all directions."""
        starts, rays = self._float32(origins, directions)
        result = self._scene.run(starts, rays, output=True)
        # Edges are watertight, but a ray aimed exactly at a vertex may slip through: misses get a second try.
        missed = np.flatnonzero(result["primID"] < 0)
        if missed.size:
            length = np.linalg.norm(rays[missed], axis=1, keepdims=True)
            second = self._scene.run(starts[missed], rays[missed] + NUDGE * length, output=True)
            for key, values in second.items():
                result[key][missed] = values
        face = result["primID"]
        u, v = result["u"], result["v"]
        return Hits(
            distance=np.where(face >= 0, result["tfar"], np.inf),
            face=face,
            barycentric=np.stack([1.0 - u - v, u, v], axis=-1),
        )

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
        normal = np.einsum("nk,nkd->nd", hits.barycentric, self._normals[self._faces[hits.face]])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.where(hits.hit[:, None] & (length > 0), normal / np.maximum(length, 1e-20), 0.0)

    def gbuffer(self, camera: Camera) -> GBuffer:
        """What `camera` sees of the mesh. Normals are interpolated from the vertices, on the side that it sees."""
        directions = camera.rays().reshape(-1, 3)
        hits = self.cast(camera.origin, directions)
        # Directions have unit depth, so that Embree's ray parameter is the depth itself.
        depth = np.where(hits.hit, hits.distance, 0.0)
        position = np.where(hits.hit[:, None], camera.origin + directions * depth[:, None], 0.0)
        # The triangle decides which side is seen. Near a silhouette an interpolated normal may lean a little away
        # from the camera in all honesty; turned round it would be lit from the wrong side.
        normal, face_normal = self.interpolated_normals(hits), self._face_normals[hits.face]
        seen_from_behind = np.sum(face_normal * directions, axis=-1) > 0
        against_face = np.sum(face_normal * normal, axis=-1) < 0
        normal = np.where((seen_from_behind != against_face)[:, None], -normal, normal)
        h, w = camera.intrinsics.shape
        return GBuffer(
            position=jnp.asarray(position.reshape(h, w, 3), jnp.float32),
            normal=jnp.asarray(normal.reshape(h, w, 3), jnp.float32),
            depth=jnp.asarray(depth.reshape(h, w), jnp.float32),
            hit=jnp.asarray(hits.hit.reshape(h, w)),
        )
