"""G-buffer: visible surface points, the interface of geometry (host, NumPy) and light (device, JAX)."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hyjax.util.errors import InputError


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


@functools.partial(jax.jit, static_argnames="sampling")
def sample_pixels(gbuffer: GBuffer, *, sampling: int) -> GBuffer:
    """Sample one pixel of each block of `sampling` × `sampling` of a G-buffer.

    Which one changes from block to block, so that `sampling`² blocks have samples in all rows and in all columns:
    their mean is that of an evenly spread pattern, about the blocks' common centre.

    Source: Keller and Heidrich, *Interleaved sampling*, 2001.
    """
    if sampling < 1:
        raise InputError(f"sampling: must be a whole number of 1 or more, got {sampling}")
    if sampling == 1:
        return gbuffer
    (h, w), k = gbuffer.hit.shape, sampling
    i, j = np.indices((-(-h // k), -(-w // k)))
    row, column = np.minimum(k * i + j % k, h - 1), np.minimum(k * j + k - 1 - i % k, w - 1)
    # A row of numbers is gathered at once: XLA's CPU backend is slow to gather them one by one.
    pixel = jnp.asarray(row * w + column)
    return jax.tree.map(lambda x: x.reshape(h * w, *x.shape[2:])[pixel], gbuffer)
