"""Upsampling that does not mix across the edges of a guide.

Bilinear interpolation gives a pixel the values of the two nearest cell centres of each axis, by their distance in
space alone. Here each of the two also counts by the conductance (Eq. 3) between the pixel's guide and the cell's,
so that a pixel beside an edge listens to its own side. Rows and columns are taken one after the other, as bilinear
interpolation may be; halfway the guide is a pixel high and a cell wide.

Source: Kopf, Cohen, Lischinski and Uyttendaele, *Joint bilateral upsampling*, SIGGRAPH 2007.
"""

import functools
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.diffusion import Norm, check_kappa
from hyjax.errors import InputError
from hyjax.pyramid import cell_means, level_shape


def guided_upsample(
    y: Float[Array, "ch cw c"],
    factor: int,
    guide: Float[Array, "h w f"],
    kappa: Float[ArrayLike, ""],
    *,
    norm: Norm = "l2",
) -> Float[Array, "h w c"]:
    """`upsample` with each cell weighted by its conductance to the pixel.

    Where the guide is constant it is `upsample`; everywhere the result lies between the values of neighbours.

    Args:
        y: cells of a level.
        factor: how many times finer the result is.
        guide: features of the finer picture; its size is the result's.
        kappa: edge sensitivity κ > 0, in the guide's units.
        norm: of guide differences, see `guide_distance`.

    Raises:
        InputError: factor below 1, a guide that is not H×W×F or does not have `y`'s number of cells, κ ≤ 0, or an
            unknown norm.
    """
    check_kappa(kappa)
    if norm not in get_args(Norm):
        raise InputError(f"norm: {norm!r} is unknown; use one of {', '.join(get_args(Norm))}")
    if guide.ndim != 3 or guide.shape[-1] == 0:
        raise InputError(f"guide: need H x W x F features, got shape {guide.shape}")
    if factor < 1 or level_shape((guide.shape[0], guide.shape[1]), factor) != y.shape[:2]:
        raise InputError(
            f"guided_upsample: {y.shape[0]}x{y.shape[1]} cells times {factor} make no picture of "
            f"{guide.shape[0]}x{guide.shape[1]}"
        )
    return y if factor == 1 else _guided_upsample(y, factor, guide, kappa, norm=norm)


@functools.partial(jax.jit, static_argnames=("factor", "norm"))
def _guided_upsample(
    y: Float[Array, "ch cw c"],
    factor: int,
    guide: Float[Array, "h w f"],
    kappa: Float[ArrayLike, ""],
    *,
    norm: Norm,
) -> Float[Array, "h w c"]:
    fine = jnp.moveaxis(guide, -1, 0)  # planes: channels innermost leave the CPU's vector units half empty
    rows_fine = cell_means(fine, factor, axis=2)
    cells = cell_means(rows_fine, factor, axis=1)
    # In at least float32, and far from where squares are rounded to zero or infinity.
    kappa = jnp.asarray(kappa, jnp.promote_types(guide.dtype, jnp.float32))
    scale = jnp.clip(kappa, 1e-15, 1e15) ** -2
    result = _guided_lerp(jnp.moveaxis(y, -1, 0), cells, rows_fine, factor, scale, norm, axis=1)
    return jnp.moveaxis(_guided_lerp(result, rows_fine, fine, factor, scale, norm, axis=2), 0, -1)


def _guided_lerp(
    y: Float[Array, "c h w"],
    coarse: Float[Array, "f h w"],
    fine: Float[Array, "f H W"],
    factor: int,
    scale: Float[Array, ""],
    norm: Norm,
    axis: int,
) -> Float[Array, "c H W"]:
    """Along one axis. Between two neighbouring centres lie `factor` pixels, at the same distances everywhere."""
    cells, length = y.shape[axis], fine.shape[axis]
    start = (factor + 1) // 2  # pixels between the centre of the cell before the first one and the picture

    def neighbours(x: Array) -> list[Array]:
        padded = jnp.pad(x, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        both = [jax.lax.slice_in_dim(padded, k, k + cells + 1, axis=axis) for k in (0, 1)]
        return [jnp.expand_dims(cell, axis + 1) for cell in both]

    missing = (start, (cells + 1) * factor - start - length)
    pixels = jnp.pad(fine, [missing if a == axis else (0, 0) for a in range(3)])
    pixels = pixels.reshape(*fine.shape[:axis], cells + 1, factor, *fine.shape[axis + 1 :])
    position = (np.arange(factor) + (0.5 if factor % 2 == 0 else 0.0)) / factor  # from the first of two centres
    near = jnp.asarray(np.expand_dims(position, [a for a in range(3) if a != axis]), scale.dtype)
    # Weights are (1-w) c(d₀) and w c(d₁) with 1/c(d) = 1 + d²/κ²; the share of the second, times both inverses:
    first, second = (1.0 + scale * _distance(pixels, cell, norm) for cell in neighbours(coarse))
    share = near * first / ((1.0 - near) * second + near * first)
    lower, upper = neighbours(y)
    result = lower + share.astype(y.dtype)[None] * (upper - lower)
    result = result.reshape(*y.shape[:axis], (cells + 1) * factor, *y.shape[axis + 1 :])
    return jax.lax.slice_in_dim(result, start, start + length, axis=axis)


def _distance(a: Float[Array, "f *s"], b: Float[Array, "f *s"], norm: Norm) -> Float[Array, "*s"]:
    """Squared distance of two guides, pixel by pixel; added one by one, as XLA's CPU reductions are slow."""
    differences = [a[k] - b[k] for k in range(a.shape[0])]
    if norm == "mean_abs":
        return (functools.reduce(jnp.add, [jnp.abs(d) for d in differences]) / len(differences)) ** 2
    return functools.reduce(jnp.add, [d * d for d in differences])
