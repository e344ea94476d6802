"""Convolutions written so that XLA runs them fast on a CPU, forwards and backwards.

All take pictures as B×H×W×C, kernels as k×k×inputs×outputs, and pad with k//2 zeros on every side, as torch does:
a picture of H pixels at stride 2 becomes one of ⌈H/2⌉, with the same pixels kept whether H is even or odd.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Picture = Float[Array, "b h w c"]
Kernel = Float[Array, "k k i o"]
Pair = tuple[int, int]


MOST_PAIR_OUTPUTS = 16
"""Most outputs for which `convolve` computes two pixels at once."""


def convolve(x: Picture, kernel: Kernel, stride: int = 1) -> Picture:
    """Convolution with a square kernel of odd width."""
    if kernel.shape[0] == 1:
        return x[:, ::stride, ::stride] @ kernel[0, 0]
    pad = kernel.shape[0] // 2
    if stride == 1 and kernel.shape[-1] <= MOST_PAIR_OUTPUTS and x.shape[2] % 2 == 0:
        return _convolve_pairs(x, kernel)
    return _convolve(x, kernel, (stride, stride), ((pad, pad), (pad, pad)))


def _convolve_pairs(x: Picture, kernel: Kernel) -> Picture:
    """Convolution of two neighbours of a row as one pixel with twice the outputs.

    It takes a third more products in two thirds of the time: XLA's CPU convolution copies the surroundings of each
    pixel for a matrix product, and few outputs do not repay the copies.
    """
    width, outputs = kernel.shape[0], kernel.shape[-1]
    pad = width // 2
    pair = [jnp.pad(kernel, ((0, 0), (b, 1 - b), (0, 0), (0, 0))) for b in (0, 1)]
    y = _convolve(x, jnp.concatenate(pair, -1), (1, 2), ((pad, pad), (pad, pad)))
    return y.reshape(*x.shape[:3], outputs)


def _convolve(x: Picture, kernel: Float[Array, "j k i o"], strides: Pair, pads: tuple[Pair, Pair]) -> Picture:
    return jax.lax.conv_general_dilated(x, kernel, strides, pads, dimension_numbers=("NHWC", "HWIO", "NHWC"))


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def convolve_depthwise(x: Picture, kernel: Float[Array, "k k 1 c"], stride: int = 1) -> Picture:
    """Depthwise convolution as a sum of k² shifted pictures.

    XLA's own takes 20 to 30 times longer on a CPU. Its derivatives are written out below: derived from the sum they
    take k² pictures each, and minutes to compile in a whole network.
    """
    width = kernel.shape[0]
    height, breadth = x.shape[1], x.shape[2]
    padded = _padded(x, width // 2)
    rows = [padded[:, i : i + height : stride] for i in range(width)]
    terms = [kernel[i, j, 0] * rows[i][:, :, j : j + breadth : stride] for i in range(width) for j in range(width)]
    return sum(terms[1:], terms[0])


def _depthwise_and_inputs(x: Picture, kernel: Kernel, stride: int) -> tuple[Picture, tuple[Picture, Kernel]]:
    return convolve_depthwise(x, kernel, stride), (x, kernel)


def _depthwise_slopes(stride: int, inputs: tuple[Picture, Kernel], slope: Picture) -> tuple[Picture, Kernel]:
    """Derivatives by picture and kernel, from the derivative by the result."""
    x, kernel = inputs
    height, breadth = x.shape[1], x.shape[2]
    width = kernel.shape[0]
    # By the picture: the slope, spread to full size, convolved with the kernel turned around.
    rows, columns = ((0, (n - 1) % stride, stride - 1) for n in (height, breadth))
    spread = jax.lax.pad(slope, jnp.zeros((), slope.dtype), ((0, 0, 0), rows, columns, (0, 0, 0)))
    by_picture = convolve_depthwise(spread, kernel[::-1, ::-1])
    padded = _padded(x, width // 2)

    def by_tap(tap: Array) -> Float[Array, "c"]:
        shifted = jax.lax.dynamic_slice(padded, (0, tap // width, tap % width, 0), x.shape)
        return jnp.sum(shifted[:, ::stride, ::stride] * slope, axis=(0, 1, 2))

    by_kernel = jax.lax.map(by_tap, jnp.arange(width * width))
    return by_picture, by_kernel.reshape(kernel.shape)


convolve_depthwise.defvjp(_depthwise_and_inputs, _depthwise_slopes)


def _padded(x: Picture, pad: int) -> Picture:
    return jnp.pad(x, ((0, 0), (pad, pad), (pad, pad), (0, 0)))


def convolve_upsampled(x: Picture, kernels: Sequence[Float[Array, "2 2 i o"]]) -> Picture:
    """Convolution after `upsample` to twice the size, with 4/9 of the products."""
    batch, height, width, _ = x.shape
    outputs = kernels[0].shape[-1]
    parts = [
        _convolve(x, kernel, (1, 1), ((1 - a, a), (1 - b, b)))
        for kernel, (a, b) in zip(kernels, PARITIES, strict=True)
    ]
    # Interleaved along one axis after the other: Core ML has no arrays of six axes.
    rows = [
        jnp.stack(columns, axis=3).reshape(batch, height, 2 * width, outputs) for columns in (parts[:2], parts[2:])
    ]
    return jnp.stack(rows, axis=2).reshape(batch, 2 * height, 2 * width, outputs)


PARITIES = ((0, 0), (0, 1), (1, 0), (1, 1))
"""Parities (row, column) of output pixels."""


def parity_kernels(kernel: Float[Array, "3 3 i o"]) -> list[Float[Array, "2 2 i o"]]:
    """Kernels on the small picture that equal a convolution after `upsample`, one per entry of `PARITIES`.

    Output pixel 2y + a sees only two rows of the small picture, y − 1 and y if a = 0, y and y + 1 if a = 1, and the
    same of columns: a 2×2 convolution for each of the four parities, of kernels with the taps added up that fall on
    the same pixel.
    """
    return [_parity(_parity(kernel, a).swapaxes(0, 1), b).swapaxes(0, 1) for a, b in PARITIES]


def _parity(kernel: Float[Array, "3 k i o"], parity: int) -> Float[Array, "2 k i o"]:
    """Merge three rows of taps into the two rows of this parity."""
    first, second, third = kernel
    return jnp.stack([first, second + third] if parity == 0 else [first + second, third])


def upsample(x: Picture, height: int, width: int) -> Picture:
    """Nearest-neighbour upsampling by 2 along both axes, cut to size."""
    return jnp.repeat(jnp.repeat(x, 2, axis=1), 2, axis=2)[:, :height, :width]
