"""Joint bilateral upsampling, which does not mix across the edges of a guide.

Bilinear interpolation gives a pixel the values of the four nearest cell centres, by their distance in space alone.
Here each of the four also counts by the conductance (Eq. 3) between the pixel's guide and the cell's, so that a
pixel beside an edge listens to its own side.

Source: Kopf, Cohen, Lischinski and Uyttendaele, *Joint bilateral upsampling*, SIGGRAPH 2007.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.checks import check_kappa
from hyjax.core.diffusion import Norm
from hyjax.core.finite import finite_or_zero
from hyjax.core.pyramid import LARGEST_FACTOR, downsample, level_shape
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, shown

LARGEST_DISTANCE = 1e30
"""Largest squared distance in units of κ; clipped there, the weights of four far cells still sum to more than 0."""


@checked_arguments
def guided_upsample(
    y: Float[Array, "ch cw c"],
    factor: int,
    guide: Float[Array, "h w f"],
    kappa: Float[ArrayLike, ""],
    *,
    coarse: Float[Array, "ch cw f"] | None = None,
    norm: Norm = "l2",
) -> Float[Array, "h w c"]:
    """Bilinear upsampling with each cell weighted by its conductance to the pixel.

    Where the guide is constant it is `upsample`; everywhere the result lies between the values of neighbours.

    >>> guide = jnp.array([[[0.0], [0.0], [1.0], [1.0]]])  # an edge in the middle
    >>> y = guided_upsample(jnp.array([[[0.0], [1.0]]]), 2, guide, 0.01)
    >>> [round(float(x), 2) for x in y[0, :, 0]]
    [0.0, 0.0, 1.0, 1.0]

    Args:
        y: cells of a level.
        factor: how many times finer the result is.
        guide: features of the finer picture; its size is the result's. Values that are not finite count as zero.
        kappa: edge sensitivity κ > 0, in the guide's units.
        coarse: features of the cells; by default the means of `guide` over them.
        norm: of guide differences, see `guide_distance`.

    Raises:
        InputError: factor below 1, a guide that is not H×W×F or does not have `y`'s number of cells, κ ≤ 0, or an
            unknown norm.
    """
    check_kappa(kappa)
    if not 1 <= factor <= LARGEST_FACTOR or level_shape((guide.shape[0], guide.shape[1]), factor) != y.shape[:2]:
        raise InputError(
            f"factor: {y.shape[0]}x{y.shape[1]} cells times {shown(factor)} do not make a picture of "
            f"{guide.shape[0]}x{guide.shape[1]}"
        )
    cells = downsample(guide, factor) if coarse is None else coarse
    return upsample_between(y, factor, guide, cells, kappa, norm=norm)


@functools.partial(jax.jit, static_argnames=("factor", "norm"))
def upsample_between(
    y: Float[Array, "ch cw c"],
    factor: int,
    guide: Float[Array, "h w f"],
    coarse: Float[Array, "ch cw f"],
    kappa: Float[ArrayLike, ""],
    *,
    norm: Norm,
) -> Float[Array, "h w c"]:
    """`guided_upsample` without its checks.

    >>> y, guide = jnp.array([[[0.0], [1.0]]]), jnp.zeros((1, 4, 1))
    >>> upsample_between(y, 2, guide, guide[:, ::2], 1.0, norm="l2").shape
    (1, 4, 1)
    """
    if factor == 1:
        return y
    y, guide, coarse = (jnp.moveaxis(x, -1, 0) for x in (y, guide, coarse))
    return jnp.moveaxis(upsample_planes(y, factor, guide, coarse, kappa, norm=norm), 0, -1)


def upsample_planes(
    y: Float[Array, "c ch cw"],
    factor: int,
    guide: Float[Array, "f h w"],
    coarse: Float[Array, "f ch cw"],
    kappa: Float[ArrayLike, ""],
    *,
    norm: Norm,
) -> Float[Array, "c h w"]:
    """`upsample_between` with channels first: last they leave the CPU's vector units half empty.

    >>> y, guide = jnp.array([[[0.0, 1.0]]]), jnp.zeros((1, 1, 4))
    >>> upsample_planes(y, 2, guide, guide[..., ::2], 1.0, norm="l2").shape
    (1, 1, 4)
    """
    (channels, rows, columns), (_, height, width) = y.shape, guide.shape
    if (rows, columns) == (1, 1):  # however much wider than the picture the cell is
        return jnp.broadcast_to(y, (channels, height, width))
    guide, coarse = finite_or_zero(guide), finite_or_zero(coarse)
    start = (factor + 1) // 2  # pixels between the centre of the cell before the first one and the picture
    pixels = guide
    for axis, count, length in ((1, rows, height), (2, columns, width)):  # XLA's CPU backend is slow to pad
        before, after = (
            jnp.zeros((*pixels.shape[:axis], n, *pixels.shape[axis + 1 :]), guide.dtype)
            for n in (start, (count + 1) * factor - start - length)
        )
        pixels = jnp.concatenate([before, pixels, after], axis)
    pixels = pixels.reshape(-1, rows + 1, factor, columns + 1, factor)  # those between four cell centres together
    values, cells = (jnp.pad(x, [(0, 0), (1, 1), (1, 1)], mode="edge") for x in (y, coarse))
    # In at least float32, and far from where squares are rounded to zero or infinity.
    kappa = jnp.asarray(kappa, jnp.promote_types(guide.dtype, jnp.float32))
    scale = jnp.clip(kappa, 1e-15, 1e15) ** -2
    second = (np.arange(factor) + (0.5 if factor % 2 == 0 else 0.0)) / factor  # weight of the second of two centres
    shares, total, weights = (1.0 - second, second), jnp.zeros(()), jnp.zeros(())
    for down, right in itertools.product((0, 1), repeat=2):

        def corner(x: Array, down: int = down, right: int = right) -> Array:
            return x[:, down : down + rows + 1, None, right : right + columns + 1, None]

        near = jnp.asarray(np.outer(shares[down], shares[right])[None, :, None, :], scale.dtype)
        weight = near / (1.0 + jnp.minimum(scale * _distance(pixels, corner(cells), norm), LARGEST_DISTANCE))
        total, weights = total + weight[None] * corner(values), weights + weight
    result = (total / weights[None]).reshape(-1, (rows + 1) * factor, (columns + 1) * factor)
    return result[:, start : start + height, start : start + width].astype(y.dtype)


def _distance(a: Float[Array, "f ..."], b: Float[Array, "f ..."], norm: Norm) -> Float[Array, "..."]:
    """Squared distance of two guides, pixel by pixel; added one by one, as XLA's CPU reductions are slow."""
    differences = [a[k] - b[k] for k in range(a.shape[0])]
    if norm == "mean_abs":
        return (functools.reduce(jnp.add, [jnp.abs(d) for d in differences]) / len(differences)) ** 2
    return functools.reduce(jnp.add, [d * d for d in differences])
