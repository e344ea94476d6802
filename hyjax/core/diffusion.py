"""Guided anisotropic diffusion (Eq. 2 and 3).

The continuous problem is ∂y/∂t = div(c ∇y) with zero flux through the border; the conductance c comes from a
guide picture, not from y, so the process is linear in y. Discretised with explicit Euler steps λ on the
4-neighbourhood it is stable and obeys the maximum principle for 0 < λ < 1/4 and 0 ≤ c ≤ 1.

Symbols of this file: y (H, W, C) is diffused, g (H, W, F) guides, c lives on the edges between pixels.

Sources: Zhao et al., *Hybrelighter*; Metzger et al., *Guided Depth Super-Resolution by Deep Anisotropic
Diffusion*, CVPR 2023; Perona and Malik, *Scale-space and edge detection using anisotropic diffusion*, 1990.
"""

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.backends import select_backend, with_fast_values
from hyjax.core.checks import check_edges, check_fidelity, check_kappa, check_step_sizes
from hyjax.core.stencil import Edges, divergence, gradient
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

Norm = Literal["l2", "mean_abs"]

LONG_RUN = 64
"""Steps beyond which the gradient trades a second forward pass for memory."""


@functools.partial(jax.jit, static_argnames="norm")
def guide_distance(guide: Float[Array, "h w f"], *, norm: Norm = "l2") -> Edges:
    """Squared distance of the guide across each edge, ‖g^p − g^n‖² of Eq. 3.

    >>> guide = jnp.array([[[0.0, 0.0], [3.0, 4.0]]])  # 1 x 2 pixels, 2 features
    >>> float(guide_distance(guide)[1][0, 0]), float(guide_distance(guide, norm="mean_abs")[1][0, 0])
    (25.0, 12.25)

    Args:
        norm: `"l2"` is the paper's squared Euclidean norm; `"mean_abs"` squares the channel mean of |Δg|, as
            Metzger's published code does. A κ does not carry over from one to the other.

    Returns:
        (vertical, horizontal), shapes (H−1, W) and (H, W−1).
    """
    if norm not in get_args(Norm):
        raise InputError(f"norm: {norm!r} is unknown; use one of {', '.join(get_args(Norm))}")
    if guide.ndim != 3 or guide.shape[-1] == 0:
        raise InputError(f"guide: need H x W x F features, got shape {guide.shape}")
    if norm == "l2":
        return _squared_distance(guide)
    mean_v, mean_h = (_sum_channels(jnp.abs(d)) / guide.shape[-1] for d in _channel_differences(guide))
    return mean_v**2, mean_h**2


@jax.custom_jvp
def _squared_distance(guide: Float[Array, "h w f"]) -> Edges:
    vertical, horizontal = _channel_differences(guide)
    return _sum_channels(vertical**2), _sum_channels(horizontal**2)


@_squared_distance.defjvp
def _squared_distance_jvp(
    primals: tuple[Float[Array, "h w f"]], tangents: tuple[Float[Array, "h w f"]]
) -> tuple[Edges, Edges]:
    """2 ∇g·∇ġ as a plain sum, which is fast backwards; a sum by halves is slow there."""
    (guide,), (moved,) = primals, tangents
    pairs = zip(_channel_differences(guide), _channel_differences(moved), strict=True)
    vertical, horizontal = (2 * jnp.sum(difference * change, axis=-1) for difference, change in pairs)
    return _squared_distance(guide), (vertical, horizontal)


def _channel_differences(guide: Float[Array, "h w f"]) -> tuple[Float[Array, "h-1 w f"], Float[Array, "h w-1 f"]]:
    """`gradient` of every channel."""
    return guide[1:] - guide[:-1], guide[:, 1:] - guide[:, :-1]


def _sum_channels(x: Float[Array, "h w f"]) -> Float[Array, "h w"]:
    """Sum over channels, by halves, then one by one, many times faster than XLA's CPU reduction."""
    while x.shape[-1] > 1 and x.shape[-1] % 2 == 0:
        half = x.shape[-1] // 2
        x = x[..., :half] + x[..., half:]
    return functools.reduce(operator.add, (x[..., k] for k in range(x.shape[-1])))


@jax.jit
def edge_stopping(distance: Edges, kappa: Float[ArrayLike, ""]) -> Edges:
    """κ² / (κ² + d²) on every edge (Eq. 3), from the squared distances of `guide_distance`; 0 if not finite.

    >>> vertical, _ = edge_stopping((jnp.array([[0.0, 0.01]]), jnp.ones((2, 1))), 0.1)
    >>> vertical.round(3).tolist()
    [[1.0, 0.5]]
    """
    vertical, horizontal = distance
    # In half precision a small κ squared is zero, and flat regions would become 0/0: at least float32, and there at
    # least the smallest κ whose square is not rounded to zero.
    dtype = jnp.promote_types(vertical.dtype, jnp.float32)
    scale = jnp.maximum(jnp.asarray(kappa, dtype), 1.01 * float(jnp.finfo(dtype).tiny) ** 0.5) ** -2

    def conductance_of(squared: Array) -> Array:
        wide = squared.astype(dtype)
        known = wide * scale < jnp.inf
        scaled = jnp.where(known, wide, 0.0) * scale  # the derivative by κ is finite, too
        return jnp.where(known, 1.0 / (1.0 + scaled), 0.0).astype(squared.dtype)

    return conductance_of(vertical), conductance_of(horizontal)


@checked_arguments
def conductance(guide: Float[Array, "h w f"], kappa: Float[ArrayLike, ""], *, norm: Norm = "l2") -> Edges:
    """Conductance between neighbouring pixels, c(g^p, g^n): how freely light flows (Eq. 3).

    >>> _, horizontal = conductance(jnp.array([[[0.0], [0.0], [0.3]]]), 0.1)
    >>> [round(float(c), 3) for c in horizontal[0]]
    [1.0, 0.1]

    Args:
        guide: features, any number of channels; nothing flows to or from pixels that are not finite.
        kappa: edge sensitivity κ > 0, in the guide's units; c = 1/2 where the guide differs by κ.
        norm: see `guide_distance`.

    Returns:
        (vertical, horizontal) in [0, 1], shapes (H−1, W) and (H, W−1).

    Raises:
        InputError: κ ≤ 0 or not finite, unknown `norm`, guide that is not H×W×F floats.
    """
    check_kappa(kappa)
    return edge_stopping(guide_distance(guide, norm=norm), kappa)


def explicit_step(y: Float[Array, "c h w"], edges: Edges, lam: Float[Array, ""]) -> Float[Array, "c h w"]:
    """y + λ div(c ∇y) (Eq. 2), channels first.

    >>> y, edges = jnp.array([[[0.0, 1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 3) for x in explicit_step(y, edges, jnp.float32(0.2))[0, 0]]
    [0.2, 0.8]
    """
    vertical, horizontal = gradient(y)
    return y + lam * divergence((edges[0] * vertical, edges[1] * horizontal))


def fidelity_step(
    y: Float[Array, "c h w"],
    edges: Edges,
    lam: Float[Array, ""],
    fidelity: Float[Array, ""],
    source: Float[Array, "c h w"],
) -> Float[Array, "c h w"]:
    """`explicit_step` with an implicit data term λ α (source − y), stable for any α.

    >>> y, edges = jnp.array([[[0.0, 1.0]]]), (jnp.ones((0, 2)), jnp.zeros((1, 1)))
    >>> stepped = fidelity_step(y, edges, jnp.float32(0.25), jnp.float32(4.0), 1.0 - y)
    >>> [round(float(x), 3) for x in stepped[0, 0]]
    [0.5, 0.5]
    """
    weight = lam * fidelity
    return ((explicit_step(y, edges, lam) + weight * source) / (1.0 + weight)).astype(y.dtype)


def scan_steps(step: Callable[[Array, Array], Array], state: Array, step_sizes: Float[Array, "n"]) -> Array:
    """`state` after `step(state, λ)` for every λ.

    Long runs go in √n blocks of √n: the backward pass keeps a state a block and redoes the rest.

    >>> float(scan_steps(lambda y, lam: y * lam, jnp.ones(()), jnp.array([0.5, 0.5, 0.25])))
    0.0625
    """

    def steps(state: Array, sizes: Array) -> tuple[Array, None]:
        return jax.lax.scan(jax.checkpoint(lambda y, lam: (step(y, lam), None)), state, sizes)

    if len(step_sizes) > LONG_RUN:
        block = math.isqrt(len(step_sizes))
        blocks, step_sizes = step_sizes[: block**2].reshape(block, block), step_sizes[block**2 :]
        state, _ = jax.lax.scan(jax.checkpoint(steps), state, blocks)
    return steps(state, step_sizes)[0]


def channels_first(y: Float[Array, "h w c"], edges: Edges) -> tuple[Float[Array, "c h w"], Edges]:
    """Channels-first copies of the picture and its edges, the layout of the steps.

    With three channels innermost the CPU's vector units run half empty. There is one copy of the edges for each
    channel, so that their gradient is added up once, after the loop: XLA is slow to reduce.

    >>> y, (vertical, _) = channels_first(jnp.ones((4, 5, 3)), (jnp.ones((3, 5)), jnp.ones((4, 4))))
    >>> y.shape, vertical.shape
    ((3, 4, 5), (3, 3, 5))
    """
    vertical, horizontal = (jnp.stack([edge] * y.shape[-1]).astype(y.dtype) for edge in edges)
    return jnp.moveaxis(y, -1, 0), (vertical, horizontal)


def _steps(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[Array, "n"],
    fidelity: Float[Array, ""] | None,
    source: Float[Array, "h w c"] | None,
) -> Float[Array, "h w c"]:
    state, edges = channels_first(y, edges)
    if fidelity is None:
        state = scan_steps(lambda x, lam: explicit_step(x, edges, lam), state, step_sizes)
    else:
        target = state if source is None else jnp.moveaxis(source, -1, 0)
        state = scan_steps(lambda x, lam: fidelity_step(x, edges, lam, fidelity, target), state, step_sizes)
    return jnp.moveaxis(state, 0, -1)


# Derivatives are always those of the plain backend, whichever computes the value.
_diffuse = jax.jit(with_fast_values(_steps, select_backend(_steps)))


@checked_arguments
def diffuse_step(y: Float[Array, "h w c"], edges: Edges, lam: Float[ArrayLike, ""]) -> Float[Array, "h w c"]:
    """Explicit Euler step of guided diffusion, zero flux through the border (Eq. 2).

    >>> y, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 3) for x in diffuse_step(y, edges, 0.2)[0, :, 0]]
    [0.2, 0.8]

    Args:
        y: what is diffused, any number of channels.
        edges: conductances from `conductance`.
        lam: step size, 0 < λ < 1/4.

    Raises:
        InputError: λ outside (0, 1/4), or edges that do not belong to a picture of this size.
    """
    return diffuse(y, edges, jnp.reshape(jnp.asarray(lam, y.dtype), (1,)))


@checked_arguments
def diffuse(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[ArrayLike, "n"] | Sequence[float],
    *,
    fidelity: Float[ArrayLike, ""] | None = None,
    source: Float[Array, "h w c"] | None = None,
) -> Float[Array, "h w c"]:
    """Repeated `diffuse_step`, the operator D of Eq. 4, one step for each entry of `step_sizes`.

    With a fidelity α the flow is ∂y/∂t = div(c ∇y) + α (source − y) instead, which comes to rest where
    (α + L) y = α source, L = −div c ∇: what `hyjax.solve` computes.

    >>> y, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 2) for x in diffuse(y, edges, jnp.full(50, 0.2))[0, :, 0]]
    [0.5, 0.5]

    Args:
        y: what is diffused, any number of channels.
        edges: conductances from `conductance`.
        step_sizes: λ of each step, all in (0, 1/4), or a stable cycle (see `hyjax.core.cycles`); may be empty.
        fidelity: α ≥ 0; None for none.
        source: what the data term pulls to, shape as `y`; by default `y` itself. Unused without a fidelity.

    Raises:
        InputError: step sizes that are not stable, α < 0, or edges or a source that do not belong to a picture of
            this size.

    Source of the data term: Nordström, *Biased anisotropic diffusion*, 1990.
    """
    check_step_sizes(step_sizes, dtype=y.dtype)
    check_edges(y, edges)
    if fidelity is not None:
        check_fidelity(fidelity)
        # In single precision at least: λ α times a bright value overflows half precision.
        fidelity = jnp.asarray(fidelity, jnp.promote_types(y.dtype, jnp.float32))
    if source is not None:
        if source.shape != y.shape:
            raise InputError(f"source: shape {source.shape} must be that of the diffused picture, {y.shape}")
        source = source.astype(y.dtype)
    return _diffuse(y, edges, jnp.asarray(step_sizes, y.dtype), fidelity, source)
