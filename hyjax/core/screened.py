"""Screened Poisson equation: the field whose differences are nearest to those that are wanted.

Symbols of this file: L = −div ∇ is the Laplacian of the pixel grid without flux through its border, α the fidelity,
g the wanted differences. The minimum of α v² + |∇v − g|² solves (α + L) v = −div g. Cosines are the eigenvectors of
L, so the equation is solved exactly by cosine transforms, here products with two small matrices.

Source: Bhat, Curless, Cohen and Zitnick, *Fourier analysis of the 2D screened Poisson equation for gradient domain
problems*, ECCV 2008.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.stencil import Edges, divergence
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import concrete


@checked_arguments
def screened_poisson(wanted: Edges, fidelity: Float[ArrayLike, ""]) -> Float[Array, "*c h w"]:
    """Solve (α + L) v = −div g: the field near zero whose differences along edges are nearest to those wanted.

    >>> wanted = jnp.zeros((0, 2)), jnp.ones((1, 1))
    >>> [round(float(x), 3) for x in screened_poisson(wanted, 1.0)[0]]
    [-0.333, 0.333]

    Args:
        fidelity: α > 0: differences count over distances of some 1/√α pixels.
    """
    alpha = concrete(jnp.asarray(fidelity))
    if alpha is not None and not 0 < float(alpha) < float("inf"):
        raise InputError(f"fidelity: must be above 0 and finite, got {float(alpha)}")
    return _solved(wanted, jnp.asarray(fidelity, wanted[0].dtype))


@jax.jit
def _solved(wanted: Edges, fidelity: Float[Array, ""]) -> Float[Array, "*c h w"]:
    source = -divergence(wanted)
    rows, columns = (jnp.asarray(_cosines(n), source.dtype) for n in source.shape[-2:])
    down, right = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in source.shape[-2:])
    inverse = 1 / (fidelity + jnp.asarray(down[:, None] + right, source.dtype))
    with jax.default_matmul_precision("highest"):
        spectrum = rows @ source @ columns.T
        return rows.T @ (spectrum * jnp.broadcast_to(inverse, spectrum.shape)) @ columns


def _cosines(count: int) -> Float[np.ndarray, "n n"]:
    """Cosine transform: the eigenvectors of the second difference of so many pixels, one a row."""
    k, i = np.arange(count)[:, None], np.arange(count)
    basis = np.cos(np.pi * (i + 0.5) * k / count) * np.sqrt(2 / count)
    basis[0] /= np.sqrt(2)
    return basis
