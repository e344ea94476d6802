"""Light transport (radiosity) between the points of a scan.

A *point* is a vertex of the mesh, or the centre of a patch of the box that closes the scan. A *radiator* is what a
ray can end on: a triangle, a patch, or an opening, which sends nothing back. The radiosity equation for points is

    E = D + T ρ E,

E the illuminance, D what comes straight from the sources, ρ the albedo, and T the mean over a point's rays, which
are cosine-distributed, of what the radiators there send back (Cohen & Wallace, *Radiosity and Realistic Image
Synthesis*, 1993). All that is sent is in the unit of E: radiance times π.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

BOUNCES = 4
"""Number of applications of T to new lights; in a room of albedo 0.5 the fifth bounce adds 3 %."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Transport:
    """Radiators seen from the points of a scan.

    Attributes:
        hits: radiator at the end of each ray of each point; triangles first, then patches, last the openings.
        faces: vertices of the triangles.
        position, normal: of the points, vertices first; world metres.
        vertices: how many of the points are vertices (static).
    """

    hits: Int[Array, "r p"]
    faces: Int[Array, "f 3"]
    position: Float[Array, "p 3"]
    normal: Float[Array, "p 3"]
    vertices: int = dataclasses.field(metadata={"static": True})

    @property
    def opening(self) -> int:
        """Radiator that stands for all openings."""
        return len(self.faces) + len(self.position) - self.vertices


@jax.jit
def send(transport: Transport, sent: Float[Array, "p c"]) -> Float[Array, "q c"]:
    """Radiosity of each radiator from that of the points: the mean of a triangle's corners, patches, and 0."""
    corners = [sent[transport.faces[:, k]] for k in range(3)]
    triangles = (corners[0] + corners[1] + corners[2]) / 3.0
    return jnp.concatenate([triangles, sent[transport.vertices :], jnp.zeros_like(sent[:1])])


@jax.jit
def gather(hits: Int[Array, "r p"], sent: Float[Array, "q c"]) -> Float[Array, "p c"]:
    """Illuminance of points by the radiators, T. Rays are added one by one, which needs no memory."""

    def add(total: Float[Array, "p c"], ends: Int[Array, "p"]) -> tuple[Float[Array, "p c"], None]:
        return total + sent[ends], None

    total, _ = jax.lax.scan(add, jnp.zeros((hits.shape[1], sent.shape[1]), sent.dtype), hits)
    return total / hits.shape[0]


@functools.partial(jax.jit, static_argnames="bounces")
def bounce(
    transport: Transport, albedo: Float[Array, "p 3"], direct: Float[Array, "p c"], bounces: int = BOUNCES
) -> Float[Array, "p c"]:
    """Indirect illuminance of the points: the Neumann series T ρ D + (T ρ)² D + …

    Args:
        direct: light straight from the sources; its channels are red, green and blue, once or several times over.
    """
    reflect = jnp.tile(albedo, (1, direct.shape[1] // 3))

    def again(_: int, indirect: Float[Array, "p c"]) -> Float[Array, "p c"]:
        return gather(transport.hits, send(transport, reflect * (direct + indirect)))

    return jax.lax.fori_loop(0, bounces, again, jnp.zeros_like(direct))
