"""Peak signal-to-noise ratio of display values."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.metrics.pictures import as_pictures, check_valid
from hyjax.util.arguments import checked_arguments


@checked_arguments(display=["image", "reference"])
def psnr(
    image: Float[ArrayLike, "h w c"],
    reference: Float[ArrayLike, "h w c"],
    *,
    valid: Bool[ArrayLike, "h w"] | None = None,
) -> Float[Array, ""]:
    """PSNR, −10 log₁₀ of the mean squared error, in dB; the range of values is 1.

    Equal pictures have +inf, and the gradient there is set to zero, as it would be of a picture that cannot get
    better.

    >>> black, grey = jnp.zeros((4, 4, 3)), jnp.full((4, 4, 3), 0.1)
    >>> round(float(psnr(grey, black)), 3)
    20.0

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].
        valid: pixels that count; None for all. Within a trace, a mask without any gives NaN.

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ, nothing valid.
    """
    image, reference = as_pictures(image=image, reference=reference)
    check_valid(valid)
    return _psnr(image, reference, valid)


@jax.jit
def _psnr(image: Array, reference: Array, valid: Array | None) -> Array:
    where = None if valid is None else valid[..., None]
    error = jnp.mean((image - reference) ** 2, where=where)
    # log's slope at zero would make a NaN of every gradient that this one is multiplied with.
    differs = error != 0.0
    return jnp.where(differs, -10.0 * jnp.log10(jnp.where(differs, error, 1.0)), jnp.inf)


@checked_arguments(display=["image", "reference"])
def squared_error_map(
    image: Float[ArrayLike, "h w c"], reference: Float[ArrayLike, "h w c"]
) -> Float[Array, "h w"]:
    """Squared error of every pixel, mean over channels; `decibels` of its mean is `psnr`.

    >>> float(squared_error_map(jnp.ones((2, 2, 3)), jnp.zeros((2, 2, 3)))[0, 0])
    1.0

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ.
    """
    image, reference = as_pictures(image=image, reference=reference)
    return jnp.mean((image - reference) ** 2, axis=-1)


@checked_arguments
def decibels(squared_error: float) -> float:
    """PSNR in dB of a mean squared error of pictures in [0, 1].

    >>> decibels(0.01), decibels(0.0)
    (20.0, inf)
    """
    return math.inf if squared_error == 0 else -10.0 * math.log10(squared_error)
