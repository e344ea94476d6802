"""Learned perceptual image patch similarity, version 0.1.

Both pictures go through a network for image classification. Its features are scaled to unit length at every
place, and the squared differences of some layers weighed by channel, fitted to human judgements.

Source: Zhang, Isola, Efros, Shechtman and Wang, *The unreasonable effectiveness of deep features as a perceptual
metric*, CVPR 2018, Eq. 1; version 0.1 of its weights, for which the pictures are standardised first.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.metrics.networks import NETWORKS
from hyjax.metrics.pictures import as_pictures
from hyjax.metrics.weights import LpipsWeights
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

CHANNEL_MEAN = np.array([[[-0.030, -0.088, -0.188]]])
"""Mean of each channel, which version 0.1 subtracts from values in [−1, 1]."""
CHANNEL_DEVIATION = np.array([[[0.458, 0.448, 0.450]]])
"""Deviation of each channel, by which version 0.1 divides."""
EPSILON = 1e-10
"""Guard against division by the length of a zero feature."""

Features = list[Float[Array, "_ _ _"]]


@checked_arguments(display=["image", "reference"])
def lpips(
    image: Float[ArrayLike, "h w 3"], reference: Float[ArrayLike, "h w 3"], weights: LpipsWeights
) -> Float[Array, ""]:
    """Perceptual distance of two pictures; 0 if they are equal (Zhang et al. 2018, Eq. 1).

    To compare many pictures with one, take its `lpips_features` once and their `lpips_distance`.

    >>> grey = jnp.full((32, 32, 3), 0.5)
    >>> float(lpips(grey, grey, load_lpips()))
    0.0

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].
        weights: see `load_lpips`.

    Returns:
        The layers' means over their places, summed.

    Raises:
        InputError: values outside [0, 1], NaN, sizes that differ, not 3 channels, or less than 31 x 31 (AlexNet) or
            16 x 16 (VGG) pixels.
    """
    return lpips_distance(*_features_of_both(image, reference, weights), weights)


@checked_arguments(display=["image", "reference"])
def lpips_map(
    image: Float[ArrayLike, "h w 3"], reference: Float[ArrayLike, "h w 3"], weights: LpipsWeights
) -> Float[Array, "h w"]:
    """Perceptual distance around every pixel, for means over a part of the picture.

    Its mean is near `lpips`, but not equal to it.

    >>> grey = jnp.full((32, 32, 3), 0.5)
    >>> lpips_map(grey, 0.5 * grey, load_lpips()).shape
    (32, 32)

    Args:
        image: display values in [0, 1].
        reference: display values in [0, 1].
        weights: see `load_lpips`.

    Returns:
        The layers' maps, bilinearly upsampled to the picture's size and summed.

    Raises:
        InputError: as `lpips`.
    """
    return lpips_distance_map(*_features_of_both(image, reference, weights), weights, shape=jnp.shape(image)[:2])


@checked_arguments(display=["image"])
def lpips_features(image: Float[ArrayLike, "h w 3"], weights: LpipsWeights) -> Features:
    """Features for LPIPS: some layers of the network, of unit length at every place.

    >>> [layer.shape for layer in lpips_features(jnp.zeros((32, 32, 3)), load_lpips())][-1]
    (1, 1, 256)

    Args:
        image: display values in [0, 1].
        weights: see `load_lpips`.

    Returns:
        One map a layer, from fine to coarse; zero where nothing in the layer responds.

    Raises:
        InputError: as `lpips`.
    """
    (image,) = as_pictures(image=image, smallest=NETWORKS[weights.net].smallest)
    return _features(image, weights)


@jax.jit
def lpips_distance(features: Features, reference: Features, weights: LpipsWeights) -> Float[Array, ""]:
    """LPIPS from the `lpips_features` of two pictures.

    >>> weights = load_lpips()
    >>> black, white = (lpips_features(jnp.full((32, 32, 3), x), weights) for x in (0.0, 1.0))
    >>> bool(lpips_distance(black, white, weights) > 0)
    True

    Args:
        features: of one picture.
        reference: of the other.
        weights: with which both were made.

    Raises:
        InputError: features of pictures of different size.
    """
    return sum((jnp.mean(m) for m in _layer_maps(features, reference, weights)), start=jnp.zeros(()))


@functools.partial(jax.jit, static_argnames="shape")
def lpips_distance_map(
    features: Features, reference: Features, weights: LpipsWeights, *, shape: tuple[int, int]
) -> Float[Array, "h w"]:
    """Map of LPIPS from the `lpips_features` of two pictures.

    >>> weights = load_lpips()
    >>> features = lpips_features(jnp.zeros((32, 32, 3)), weights)
    >>> float(lpips_distance_map(features, features, weights, shape=(32, 32)).max())
    0.0

    Args:
        features: of one picture.
        reference: of the other.
        weights: with which both were made.
        shape: height and width of the pictures.

    Raises:
        InputError: features of pictures of different size.
    """
    maps = (jax.image.resize(m, shape, "bilinear") for m in _layer_maps(features, reference, weights))
    return sum(maps, start=jnp.zeros(()))


def _features_of_both(
    image: Float[ArrayLike, "h w 3"], reference: Float[ArrayLike, "h w 3"], weights: LpipsWeights
) -> tuple[Features, Features]:
    image, reference = as_pictures(image=image, reference=reference, smallest=NETWORKS[weights.net].smallest)
    return _features(image, weights), _features(reference, weights)


def _layer_maps(features: Features, reference: Features, weights: LpipsWeights) -> list[Float[Array, "_ _"]]:
    shapes, others = ([layer.shape for layer in f] for f in (features, reference))
    if shapes != others:
        raise InputError(f"features of pictures of different size cannot be compared: {shapes[0]} and {others[0]}")
    # The sum over channels is one pass, which a product with a matrix of a single column would not be.
    return [
        jnp.sum(head[None, None] * (a - b) ** 2, axis=-1) for head, a, b in zip(weights.heads, features, reference)
    ]


@jax.jit
def _features(image: Float[Array, "h w 3"], weights: LpipsWeights) -> Features:
    kind = jnp.result_type(image, weights.kernels[0])
    x = (2.0 * image.astype(kind) - 1.0 - CHANNEL_MEAN.astype(kind)) / CHANNEL_DEVIATION.astype(kind)
    features = []
    for layer, kernel, bias in zip(NETWORKS[weights.net].layers, weights.kernels, weights.biases):
        x = jax.nn.relu(_convolve(_pool(x, layer.pool), kernel, layer.stride, layer.padding) + bias[None, None])
        if layer.compared:
            features.append(_unit(x))
    return features


def _convolve(
    x: Float[Array, "h w i"], kernel: Float[Array, "k k i o"], stride: int, padding: int
) -> Float[Array, "nh nw o"]:
    found = jax.lax.conv_general_dilated(
        x[None],
        kernel.astype(x.dtype),
        (stride, stride),
        [(padding, padding)] * 2,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
        precision=jax.lax.Precision.HIGHEST,  # a GPU would drop to 10 bits
    )
    return found[0]


def _pool(x: Float[Array, "h w c"], width: int) -> Float[Array, "nh nw c"]:
    """Max pooling over squares of this width with stride 2, without padding."""
    if width == 1:
        return x
    for axis in (0, 1):
        length = x.shape[axis] - width + 1
        x = functools.reduce(jnp.maximum, (jax.lax.slice_in_dim(x, k, k + length, 2, axis) for k in range(width)))
    return x


def _unit(x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
    squared = jnp.sum(x * x, axis=-1, keepdims=True)
    responds = squared > 0.0  # the root has no slope at zero
    length = jnp.where(responds, jnp.sqrt(jnp.where(responds, squared, 1.0)), 0.0)
    return x / (length + EPSILON)
