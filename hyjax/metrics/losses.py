"""Differentiable objective of schedule tuning and guide training: the visible error of a relight filter.

Two filters are compared *as they are displayed*: both are multiplied with the camera's frame and encoded for
display, so that an error on black cloth weighs as little as it shows. With the difference d of the two pictures,

    loss = pixel · mean ρ(d)  +  gradient · mean over s of mean ρ(∇ d_s)  +  perceptual · P(picture, target picture)

where ρ is Charbonnier's function and d_s the mean of d over cells of s×s pixels, valid ones only. The second term
asks for the right *shape* of the light. Its coarse scales matter: neighbouring pixels alone would prefer a flat
filter to a right one with a little noise.

Symbols of this file: d (H, W, 3) is zero where not valid, and channels first, (3, H, W), in the gradient term; v
(H, W) is 1 on valid pixels and 0 elsewhere.

Sources: Charbonnier et al., *Two deterministic half-quadratic regularization algorithms for computed imaging*, ICIP
1994; gradient-domain comparison at several scales as in Li and Snavely, *MegaDepth*, CVPR 2018 (Eq. 4).
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.core.pyramid import downsample
from hyjax.core.stencil import Edges, divergence, gradient
from hyjax.light.color import held, unclipped
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import concrete

EPSILON = 1.0 / 255.0
"""Step of an 8-bit picture: below it an error does not show, and ρ is flat."""

SCALES = (1, 4, 16, 64)
"""Cell widths in pixels of the gradient term, each a multiple of the one before. The finest sees noise and halos,
the coarsest how the light falls off over the picture: white noise fades as 1/s, missing shading grows with s."""

Perceptual = Callable[[Float[Array, "h w 3"], Float[Array, "h w 3"]], Float[Array, ""]]


@dataclasses.dataclass(frozen=True)
class LossWeights:
    """Weights of the terms of `display_loss`.

    The first two are of one unit (display values) and count alike. With far more `gradient` the finest scale would
    rule, and a right filter with a little noise would cost as much as one without shading. A perceptual distance
    takes a network, hence 0.

    Attributes:
        pixel: difference of display values.
        gradient: difference of their slopes, at several scales.
        perceptual: the function given as `perceptual`, in its own unit.

    Raises:
        InputError: a weight that is negative or not finite.
    """

    pixel: float = 1.0
    gradient: float = 1.0
    perceptual: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{field.name}: a loss weight must be finite and >= 0, got {value}")


@checked_arguments
def charbonnier(x: Float[Array, "*s"], *, epsilon: Float[ArrayLike, ""] = EPSILON) -> Float[Array, "*s"]:
    """√(x² + ε²) − ε: |x| for large x, x²/2ε near zero, smooth throughout.

    >>> [round(float(x), 3) for x in charbonnier(jnp.array([0.0, 1.0, -1.0]))]
    [0.0, 0.996, 0.996]

    Args:
        x: any values.
        epsilon: scale of the turn from a parabola into a line, > 0, in the unit of x.

    Raises:
        InputError: ε ≤ 0.

    Source: Charbonnier et al., ICIP 1994.
    """
    value = concrete(epsilon)
    if value is not None and not value > 0:
        raise InputError(f"epsilon: must be > 0, got {value}")
    # The difference as written would cancel to zero for small x.
    squared = x * x
    return squared / (jnp.sqrt(squared + epsilon**2) + epsilon)


@checked_arguments
@jax.jit
def display_unclipped(relight_filter: Float[Array, "*s"], frame: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Filter times frame, encoded for display without clipping.

    The curve is continued above white, and its straight piece below black, so that light which is too bright still
    has a slope that leads back. Up to white this is `to_display`.

    >>> white = jnp.ones((1, 1, 3))
    >>> [round(float(display_unclipped(x * white, white)[0, 0, 0]), 2) for x in (0.0, 1.0, 1.2, 3.0)]
    [0.0, 0.96, 1.0, 1.57]

    Args:
        relight_filter: linear, ≥ 0.
        frame: camera picture, linear.

    Returns:
        Display values, above 1 where the product is.
    """
    return unclipped(held(relight_filter * frame))


@checked_arguments
def filter_loss(
    relight_filter: Float[Array, "h w 3"],
    target: Float[Array, "h w 3"],
    frame: Float[Array, "h w 3"],
    valid: Bool[Array, "h w"],
    *,
    weights: LossWeights | None = None,
    perceptual: Perceptual | None = None,
) -> Float[Array, ""]:
    """Loss between a frame under two relight filters; 0 only if they look the same.

    To compare many filters with one target, encode the target once with `display_unclipped` and call
    `display_loss`.

    >>> grey, valid = jnp.full((8, 8, 3), 0.5), jnp.ones((8, 8), bool)
    >>> float(filter_loss(grey, grey, grey, valid)), float(filter_loss(2 * grey, grey, grey, valid)) > 0.1
    (0.0, True)

    Args:
        relight_filter: to judge; linear, ≥ 0.
        target: the true filter; linear, ≥ 0.
        frame: camera picture, linear.
        valid: where the target is valid. Elsewhere neither filter matters, with any values.
        weights: default `LossWeights()`.
        perceptual: see `display_loss`.

    Returns:
        See `display_loss`.

    Raises:
        InputError: sizes differ, or a perceptual weight without its function.
    """
    picture, target_picture = (_display_where(valid, f, frame) for f in (relight_filter, target))
    return display_loss(picture, target_picture, valid, weights=weights, perceptual=perceptual)


@checked_arguments
def display_loss(
    picture: Float[Array, "h w 3"],
    target_picture: Float[Array, "h w 3"],
    valid: Bool[Array, "h w"],
    *,
    weights: LossWeights | None = None,
    perceptual: Perceptual | None = None,
) -> Float[Array, ""]:
    """`filter_loss` of pictures made by `display_unclipped`.

    >>> grey, valid = jnp.full((8, 8, 3), 0.5), jnp.zeros((8, 8), bool)
    >>> float(display_loss(grey, 0.0 * grey, valid))  # nothing is valid
    0.0

    Args:
        picture: display values of the frame under the judged filter.
        target_picture: display values of the frame under the true one.
        valid: where the target is valid.
        weights: default `LossWeights()`.
        perceptual: distance of two display pictures in [0, 1], both black outside `valid`; needed, and called, only
            if its weight is not 0.

    Returns:
        Mean over pixels, channels and edges, so that the size of the picture does not matter; 0 if no pixel is
        valid.

    Raises:
        InputError: sizes differ, or a perceptual weight without its function.
    """
    weights = LossWeights() if weights is None else weights
    d = jnp.where(valid[..., None], picture - target_picture, 0.0)
    v = valid.astype(d.dtype)
    loss = jnp.zeros((), d.dtype)
    if weights.pixel:
        loss += weights.pixel * _pixel_term(d, v)
    if weights.gradient:
        loss += weights.gradient * _gradient_term(jnp.moveaxis(d, -1, 0), v)
    if weights.perceptual:
        if perceptual is None:
            raise InputError(
                f"perceptual: weights.perceptual is {weights.perceptual} and needs a function of two pictures"
            )
        clipped = (jnp.where(valid[..., None], jnp.clip(x, 0.0, 1.0), 0.0) for x in (picture, target_picture))
        loss += weights.perceptual * perceptual(*clipped)
    return loss


@jax.jit
def _display_where(
    valid: Bool[Array, "h w"], relight_filter: Float[Array, "h w 3"], frame: Float[Array, "h w 3"]
) -> Float[Array, "h w 3"]:
    """`display_unclipped`, black where not valid.

    Masked before the curve, whose slope times zero is not zero where a filter is infinite or not a number. Channel
    by channel, because with a mask spread over the last axis XLA's CPU backend falls back to scalar code.
    """
    channels = jnp.moveaxis(relight_filter, -1, 0), jnp.moveaxis(frame, -1, 0)
    picture = jax.lax.map(lambda x: display_unclipped(jnp.where(valid, x[0], 0.0), x[1]), channels)
    return jnp.moveaxis(picture, 0, -1)


@jax.jit
def _pixel_term(d: Float[Array, "h w 3"], v: Float[Array, "h w"]) -> Float[Array, ""]:
    """Σ ρ(d) / 3 Σ v; 0 if nothing is valid."""
    return jnp.sum(charbonnier(d)) * _reciprocal(3.0 * jnp.sum(v))


@jax.custom_jvp
@jax.jit
def _gradient_term(d: Float[Array, "3 h w"], v: Float[Array, "h w"]) -> Float[Array, ""]:
    """Mean over the scales of Σ w ρ(∇ d_s) / 3 Σ w; a scale without an edge adds nothing."""
    return _term_and_slope(d, v, slope=False)[0]


@_gradient_term.defjvp
def _gradient_term_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    term, slope = _term_and_slope(*primals, slope=True)
    return term, jnp.sum(slope * tangents[0])  # v is a mask and does not move


@functools.partial(jax.jit, static_argnames="slope")
def _term_and_slope(d: Float[Array, "3 h w"], v: Float[Array, "h w"], *, slope: bool) -> tuple[Array, Array]:
    """Gradient term and, if asked for, its derivative by d.

    Written out because what JAX derives from strided slices takes XLA's CPU backend longer, to run and to compile.
    The loop over channels is one because XLA would otherwise work d out anew for each use of it.
    """
    h, w = v.shape
    # Filled up with invalid pixels to whole cells, so that means of means are the means.
    missing = [(0, -length % SCALES[-1]) for length in v.shape]
    d, v = jnp.pad(d, [(0, 0), *missing]), jnp.pad(v, missing)
    ratios = [scale // finer for scale, finer in zip(SCALES[1:], SCALES)]

    levels = []
    for share in _levels(v, ratios):  # what part of a cell is valid
        # An edge counts for the part of the pairs of pixels across it that are valid both.
        pairs = share[1:] * share[:-1], share[:, 1:] * share[:, :-1]
        count = d.shape[0] * len(SCALES) * (jnp.sum(pairs[0]) + jnp.sum(pairs[1]))
        levels.append((_reciprocal(share), pairs, _reciprocal(count)))

    def channel(d: Float[Array, "h w"]) -> tuple[Array, list[Edges]]:
        total, fluxes = jnp.zeros((), d.dtype), []
        for cells, (to_mean, pairs, to_term) in zip(_levels(d, ratios), levels):
            down, right = gradient(cells * to_mean)
            total += to_term * (jnp.sum(pairs[0] * charbonnier(down)) + jnp.sum(pairs[1] * charbonnier(right)))
            if slope:
                fluxes.append(
                    (to_term * pairs[0] * _charbonnier_slope(down), to_term * pairs[1] * _charbonnier_slope(right))
                )
        return total, fluxes

    terms, fluxes = jax.lax.map(channel, d)
    slopes = jnp.zeros((d.shape[0], 0, 0), d.dtype)
    for k, (flux, (to_mean, *_)) in reversed([*enumerate(zip(fluxes, levels))]):
        # The divergence is the negative adjoint of the gradient, _downsample_adjoint that of the mean over cells.
        adjoint = -to_mean[None] * divergence(flux)
        slopes = adjoint + _downsample_adjoint(slopes, ratios[k]) if k < len(ratios) else adjoint
    return jnp.sum(terms), slopes[..., :h, :w]


def _charbonnier_slope(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Derivative of `charbonnier`."""
    return x / jnp.sqrt(x * x + EPSILON**2)


def _levels(y: Float[Array, "h w"], ratios: list[int]) -> list[Array]:
    levels = [y]
    for ratio in ratios:
        levels.append(downsample(levels[-1][..., None], ratio)[..., 0])
    return levels


def _downsample_adjoint(cells: Float[Array, "c ch cw"], ratio: int) -> Float[Array, "c h w"]:
    """Adjoint of the mean over cells: each pixel gets its share of the cell's value."""
    return jnp.repeat(jnp.repeat(cells / ratio**2, ratio, axis=1), ratio, axis=2)


def _reciprocal(x: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Reciprocal 1/x; 0 where x is 0."""
    return jnp.where(x > 0.0, 1.0 / jnp.where(x > 0.0, x, 1.0), 0.0)
