"""Steady state of diffusion with a data term: the converged solution, to judge cascades by.

Symbols of this file: L = −div c ∇ is the Laplacian of the conductances (symmetric, ≥ 0), α the fidelity, r the
source: (α + L) y = α r. With 0 < α ≪ 1 a pixel is a mean of r over some 1/√α pixels around it, as far as edges let
it.

The system is solved by conjugate gradients on its diagonal's scale, which is as fast on a CPU as a multilevel
preconditioner (Bramble, Pasciak and Xu 1990): that takes a third of the iterations, each several times as dear.
Derivatives are implicit (`jax.lax.custom_linear_solve`): they cost one more solve, however many iterations there
were.

Source of the data term: Nordström, *Biased anisotropic diffusion*, 1990.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.checks import check_edges, check_fidelity
from hyjax.core.stencil import Edges, divergence, gradient
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import concrete

TOLERANCE = 1e-6
MOST_ITERATIONS = 1000


@checked_arguments
def solve(
    source: Float[Array, "h w c"],
    edges: Edges,
    fidelity: Float[ArrayLike, ""],
    *,
    start: Float[Array, "h w c"] | None = None,
    tolerance: float = TOLERANCE,
    most_iterations: int = MOST_ITERATIONS,
) -> Float[Array, "h w c"]:
    """Solve (α + L) y = α source for y, the limit of `diffuse` with this fidelity.

    >>> source, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 3) for x in solve(source, edges, 1.0)[0, :, 0]]
    [0.333, 0.667]

    Args:
        source: any number of channels, solved together.
        edges: conductances from `hyjax.conductance`.
        fidelity: α > 0.
        start: initial guess, such as a cascade's result; by default the source.
        tolerance: of the residual, relative to that of `start`.
        most_iterations: after which the solution is returned as it is.

    Raises:
        InputError: α ≤ 0, a source that is not floating point, edges or a start that do not belong to it, or a
            tolerance or number of iterations that cannot end.
    """
    check_edges(source, edges)
    if start is not None and start.shape != source.shape:
        raise InputError(f"start: shape {start.shape} is not that of the source, {source.shape}")
    check_fidelity(fidelity)
    if (value := concrete(fidelity)) is not None and value == 0:
        raise InputError("fidelity: must be > 0; without it everything flows until all is one colour")
    if not 0 <= tolerance < math.inf:
        raise InputError(f"tolerance: must be finite and >= 0, got {tolerance}")
    if most_iterations < 1:
        raise InputError(f"most_iterations: must be at least 1, got {most_iterations}")
    start = source if start is None else start
    return _solve(source, edges, jnp.asarray(fidelity, source.dtype), start, tolerance, most_iterations)


@functools.partial(jax.jit, static_argnames="most_iterations")
def _solve(
    source: Float[Array, "h w c"],
    edges: Edges,
    fidelity: Float[Array, ""],
    start: Float[Array, "h w c"],
    tolerance: Float[Array, ""],
    most_iterations: int,
) -> Float[Array, "h w c"]:
    vertical, horizontal = edges
    around = jnp.zeros(source.shape[:2], source.dtype).at[:-1].add(vertical).at[1:].add(vertical)
    around = around.at[:, :-1].add(horizontal).at[:, 1:].add(horizontal)
    diagonal = jax.lax.stop_gradient(fidelity + around)[None]
    apply = functools.partial(_apply, edges=edges, fidelity=fidelity)
    # Solved for what `start` lacks: a first guess given to `cg` would also be that of the backward solve, where the
    # far smaller slopes would drown in its rounding errors.
    right, first = (jnp.moveaxis(x, -1, 0) for x in (fidelity * source, jax.lax.stop_gradient(start)))
    correction, _ = jax.scipy.sparse.linalg.cg(
        apply,
        right - apply(first),
        M=lambda residual: residual / diagonal,
        tol=tolerance,
        maxiter=most_iterations,
    )
    return jnp.moveaxis(first + correction, 0, -1)


def _apply(y: Float[Array, "c h w"], *, edges: Edges, fidelity: Float[Array, ""]) -> Float[Array, "c h w"]:
    """(α + L) y."""
    vertical, horizontal = gradient(y)
    return fidelity * y - divergence((edges[0][None] * vertical, edges[1][None] * horizontal))
