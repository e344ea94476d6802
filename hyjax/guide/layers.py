"""Layers of the networks in this package."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from hyjax.guide.convolution import Picture, convolve, convolve_depthwise

Shape = tuple[int, ...]
Initial = Callable[[Array, Shape], Float[Array, "k k i o"]]
"""Initialiser: (key, shape) → kernel."""


def _initial(gain: float, fan: Callable[[Shape], float], *, uniform: bool = False) -> Initial:
    """Initialiser of kernels of variance gain/fan."""

    def draw(key: Array, shape: Shape) -> Float[Array, "k k i o"]:
        # Compiled for every power of four of numbers, of which it takes some: once a shape would take longer.
        count = math.prod(shape)
        drawn = 4 ** math.ceil(math.log(count, 4))
        sample = 3**0.5 * jax.random.uniform(key, drawn, minval=-1) if uniform else jax.random.normal(key, drawn)
        return (gain / fan(shape)) ** 0.5 * sample[:count].reshape(shape)

    return draw


# k×k×inputs×outputs; depthwise kernels have one input and, for each of their groups, one output.
KAIMING_FAN_OUT = _initial(2, lambda shape: shape[0] * shape[1] * shape[3])
KAIMING_DEPTHWISE = _initial(2, lambda shape: shape[0] * shape[1])
KAIMING_UNIFORM = _initial(2, lambda shape: shape[0] * shape[1] * shape[2], uniform=True)
XAVIER_UNIFORM = _initial(2, lambda shape: shape[0] * shape[1] * (shape[2] + shape[3]), uniform=True)

EPSILON = 1e-5
"""Constant that batch norms add to variances, as in torch."""


class Conv(nnx.Module):
    """Convolution padded with zeros so that stride 1 keeps the size.

    Attributes:
        kernel: k×k×inputs×outputs; of a depthwise convolution k×k×1×channels.
        bias: one number an output, or None.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        width: int = 3,
        stride: int = 1,
        *,
        depthwise: bool = False,
        bias: bool = False,
        initial: Initial,
        rngs: nnx.Rngs,
    ) -> None:
        shape = (width, width, 1 if depthwise else inputs, outputs)
        self.kernel = nnx.Param(initial(rngs.params(), shape))
        self.bias = nnx.data(nnx.Param(jnp.zeros(outputs)) if bias else None)
        self.stride = stride
        self.depthwise = depthwise

    def __call__(self, x: Picture) -> Picture:
        return self.add_bias((convolve_depthwise if self.depthwise else convolve)(x, self.kernel[...], self.stride))

    def add_bias(self, y: Picture) -> Picture:
        """Add the bias, if there is one, to the products."""
        return y if self.bias is None else y + self.bias[...]


class ConvNorm(nnx.Module):
    """Convolution, batch norm, and a rectifier if wanted.

    Attributes:
        norm: the batch norm: torch's momentum 0.1; None once it is folded into the convolution.
        names: of the two in torch, within the module that holds both.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        width: int = 3,
        stride: int = 1,
        *,
        names: tuple[str, str],
        depthwise: bool = False,
        relu: bool = True,
        initial: Initial | None = None,
        rngs: nnx.Rngs,
    ) -> None:
        initial = initial or (KAIMING_DEPTHWISE if depthwise else KAIMING_FAN_OUT)
        self.conv = Conv(inputs, outputs, width, stride, depthwise=depthwise, initial=initial, rngs=rngs)
        self.norm: Any = nnx.data(nnx.BatchNorm(outputs, momentum=0.9, epsilon=EPSILON, rngs=rngs))
        self.names = names
        self.relu = relu

    def __call__(self, x: Picture) -> Picture:
        return self.activate(self.conv(x))

    def activate(self, y: Picture) -> Picture:
        """Apply batch norm and rectifier to the convolution's result."""
        y = y if self.norm is None else self.norm(y)
        return jax.nn.relu(y) if self.relu else y

    def fold(self) -> None:
        """Put the batch norm with its running statistics into kernel and bias of the convolution."""
        norm = self.norm
        if norm is None:
            return
        scale = norm.scale[...] / jnp.sqrt(norm.var[...] + EPSILON)
        self.conv.kernel.set_value(self.conv.kernel[...] * scale)
        self.conv.bias = nnx.Param(norm.bias[...] - norm.mean[...] * scale)
        self.norm = None
