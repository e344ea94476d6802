"""Structural similarity.

Source: Wang, Bovik, Sheikh and Simoncelli, *Image quality assessment: from error visibility to structural
similarity*, IEEE TIP 2004, Eq. 13, with the paper's constants and window. The picture goes on mirrored beyond its
border, as in scikit-image.

Symbols of this file: x, y the two pictures, channels first (c, h, w); μ their means under the window, σ² their
variances, σ_xy their covariance.
"""

import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.metrics.pictures import as_pictures, check_valid
from hyjax.util.arguments import checked_arguments

SIGMA = 1.5
"""Standard deviation of the Gaussian window, in pixels."""
RADIUS = 5
"""Radius of the window in pixels, so it is 11 wide."""
K1, K2 = 0.01, 0.03


@checked_arguments(display=["image", "reference"])
def ssim_map(image: Float[ArrayLike, "h w c"], reference: Float[ArrayLike, "h w c"]) -> Float[Array, "h w"]:
    """Structural similarity around every pixel, mean over channels (Wang et al. 2004, Eq. 13).

    Within `RADIUS` of the border it stands for the mirrored picture, and `ssim` leaves it out.

    >>> grey = jnp.full((12, 12, 3), 0.5)
    >>> ssim_map(grey, grey).shape
    (12, 12)

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].

    Returns:
        Values in [−1, 1]; 1 where the surroundings are equal.

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ, less than 11 x 11 pixels.
    """
    return _ssim_map(*as_pictures(image=image, reference=reference, smallest=2 * RADIUS + 1))


@checked_arguments(display=["image", "reference"])
def ssim(
    image: Float[ArrayLike, "h w c"],
    reference: Float[ArrayLike, "h w c"],
    *,
    valid: Bool[ArrayLike, "h w"] | None = None,
) -> Float[Array, ""]:
    """Mean structural similarity (Wang et al. 2004).

    Only pixels whose whole window lies in the picture count, as in scikit-image: the `RADIUS` rows and columns at
    each border do not, valid or not. The windows of valid pixels do look at neighbours that are not.

    >>> stripes = jnp.tile(jnp.array([[[0.2], [0.8]]]), (16, 8, 1))
    >>> round(float(ssim(stripes, stripes)), 4), float(ssim(1.0 - stripes, stripes)) < 0
    (1.0, True)

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].
        valid: pixels that count; None for all. Within a trace, a mask without any gives NaN.

    Returns:
        A value in [−1, 1]; 1 for equal pictures.

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ, less than 11 x 11 pixels, nothing valid.
    """
    similarity = ssim_map(image, reference)
    check_valid(valid, border=RADIUS)
    inside = (slice(RADIUS, -RADIUS),) * 2
    return jnp.mean(similarity[inside], where=None if valid is None else jnp.asarray(valid)[inside])


@jax.jit
def _ssim_map(image: Float[Array, "h w c"], reference: Float[Array, "h w c"]) -> Float[Array, "h w"]:
    # About mid grey, so that less is lost where variances are differences of squares.
    x, y = (jnp.moveaxis(picture, -1, 0) - 0.5 for picture in (image, reference))
    # Only the sum of the two variances is needed.
    mean_x, mean_y, squares, products = _window(jnp.stack([x, y, x * x + y * y, x * y]))
    variances = squares - (mean_x**2 + mean_y**2)
    covariance = products - mean_x * mean_y
    mean_x, mean_y = mean_x + 0.5, mean_y + 0.5
    light = (2.0 * mean_x * mean_y + K1**2) / (mean_x**2 + mean_y**2 + K1**2)
    return jnp.mean(light * (2.0 * covariance + K2**2) / (variances + K2**2), axis=0)


def _window(fields: Float[Array, "n c h w"]) -> Float[Array, "n c h w"]:
    """Means under a Gaussian window around every pixel, separably."""
    weights = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / SIGMA) ** 2)
    weights /= weights.sum()
    for axis in (2, 3):
        length = fields.shape[axis]
        mirrored = jnp.pad(fields, [(RADIUS, RADIUS) if a == axis else (0, 0) for a in range(4)], mode="symmetric")
        # Else XLA would work out the first direction anew for every term of the second.
        mirrored = jax.lax.optimization_barrier(mirrored)
        shifted = (jax.lax.slice_in_dim(mirrored, k, k + length, axis=axis) for k in range(weights.size))
        fields = functools.reduce(operator.add, (float(w) * s for w, s in zip(weights, shifted)))
    return fields
