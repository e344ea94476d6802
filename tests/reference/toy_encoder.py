"""An encoder that compiles in seconds."""

import jax
from flax import nnx

from hyjax.guide.layers import ConvNorm


class ToyEncoder(nnx.Module):
    """Two strided convolutions."""

    def __init__(self, *, rngs: nnx.Rngs) -> None:
        self.channels = (8, 8)
        self.first = ConvNorm(3, 8, 3, 2, names=("conv1", "bn1"), rngs=rngs)
        self.second = ConvNorm(8, 8, 3, 2, names=("conv2", "bn2"), rngs=rngs)

    def __call__(self, image: jax.Array) -> list[jax.Array]:
        first = self.first(image)
        return [first, self.second(first)]
