"""G-buffer: visible surface points, the interface of geometry (host, NumPy) and light (device, JAX)."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class GBuffer:
    """Surface points seen by a camera, one per pixel.

    Attributes:
        position: world position in metres; zero where no surface was hit.
        normal: unit surface normal in world axes, on the side that the camera sees; zero where no surface was hit.
        depth: distance along the camera's axis in metres; zero where no surface was hit.
        hit: whether the pixel's ray met the mesh.
        face: triangle that was hit, -1 where none was; None if the surface is no mesh.
        barycentric: weights of its three vertices; None likewise.
    """

    position: Float[Array, "h w 3"]
    normal: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    hit: Bool[Array, "h w"]
    face: Int[Array, "h w"] | None = None
    barycentric: Float[Array, "h w 3"] | None = None

    @property
    def open_depth(self) -> Float[Array, "h w"]:
        """Depth, infinite in holes."""
        return jnp.where(self.hit, self.depth, jnp.inf)
