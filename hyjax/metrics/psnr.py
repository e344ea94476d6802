"""Peak signal-to-noise ratio of display values."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.metrics.pictures import as_pictures, check_valid


def psnr(
    image: Float[ArrayLike, "h w c"],
    reference: Float[ArrayLike, "h w c"],
    *,
    valid: Bool[ArrayLike, "h w"] | None = None,
) -> Float[Array, ""]:
    """−10 log₁₀ of the mean squared error, in dB; the range of values is 1.

    Equal pictures have +inf, and the gradient there is set to zero, as it would be of a picture that cannot get
    better.

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].
        valid: pixels that count; None for all. Within a trace, a mask without any gives NaN.

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ, nothing valid.
    """
    image, reference = as_pictures(image=image, reference=reference)
    check_valid(valid, image.shape[:2])
    return _psnr(image, reference, valid)


@jax.jit
def _psnr(image: Array, reference: Array, valid: Array | None) -> Array:
    where = None if valid is None else valid[..., None]
    error = jnp.mean((image - reference) ** 2, where=where)
    # log's slope at zero would make a NaN of every gradient that this one is multiplied with.
    differs = error != 0.0
    return jnp.where(differs, -10.0 * jnp.log10(jnp.where(differs, error, 1.0)), jnp.inf)
