"""Weights of guide networks, in and out of files.

Tensors have the names and shapes of segmentation_models_pytorch's Unet over timm's encoders, as in
`encoder.model.blocks.0.0.conv.weight`, `decoder.blocks.0.conv1.0.weight` and `segmentation_head.0.bias`, so that
weights go from there to here and back. Our own files are safetensors with text beside the tensors: `encoder`,
`features`, `kappa` (the κ that goes with the features as they are), `norm`, and notes of the training.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import safetensors.numpy
from flax import nnx
from jaxtyping import Shaped

from hyjax.guide.layers import ConvNorm
from hyjax.guide.network import ENCODERS, GuideNetwork
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write
from hyjax.util.tensors import read_tensors

Arrays = dict[str, Shaped[np.ndarray, "..."]]
Dtype = Literal["float16", "float32"]

LEAVES = {"kernel": "weight", "scale": "weight", "bias": "bias", "mean": "running_mean", "var": "running_var"}
"""Torch's names of the arrays of a layer."""
COUNTER = "num_batches_tracked"
"""Counters of torch's batch norms, which nothing uses."""
CLASSIFIER = ("conv_head.", "norm_head.", "classifier.")
"""Prefixes of the layers after the encoder in timm's models."""
HUB = "hf://"


@checked_arguments
def save_guide(
    path: str | os.PathLike[str],
    network: GuideNetwork,
    *,
    kappa: float = 1.0,
    metadata: Mapping[str, str] | None = None,
    dtype: Dtype | None = None,
) -> None:
    """Write a network's weights to a safetensors file, whole or not at all.

    Args:
        path: where to.
        network: the network.
        kappa: κ that goes with its features as they are.
        metadata: further notes, such as the training's command and seed.
        dtype: precision of the tensors in the file; by default half, or single for those that half cannot hold.

    Raises:
        InputError: a weight is not finite, or too large for `dtype`, or the file cannot be written.
    """
    tensors: Arrays = {}
    for name, variable in named_variables(network).items():
        array = to_torch_layout(np.asarray(variable[...], np.float32))
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} is not finite; it cannot be saved")
        largest = float(np.abs(array).max())
        fits = largest <= float(jnp.finfo(dtype or "float16").max)
        if dtype is not None and not fits:
            raise InputError(f"{path}: {name} reaches {largest:.4g}, too large for {dtype}; save it as float32")
        tensors[name] = np.ascontiguousarray(array.astype(dtype or ("float16" if fits else "float32")))
    texts = {
        **(metadata or {}),
        "encoder": network.encoder_name,
        "features": str(network.features),
        "kappa": repr(float(kappa)),
        "norm": "l2",
    }
    with atomic_write(Path(path)) as temporary:
        temporary.write_bytes(safetensors.numpy.save(tensors, metadata=texts))


@checked_arguments
def load_network(
    path: str | os.PathLike[str], *, encoder: str | None = None
) -> tuple[GuideNetwork, dict[str, str]]:
    """Read a network from a file, ready for inference.

    Args:
        path: safetensors of ours or of an smp Unet, or `hf://OWNER/NAME/FILE`.
        encoder: name in `ENCODERS`; by default the file's own word, or else the first that fits it.

    Returns:
        (network, the file's metadata).

    Raises:
        InputError: the file cannot be read, or belongs to another network.
    """
    arrays, metadata = read_weights(path)
    encoder = encoder or metadata.get("encoder") or _recognised(path, arrays)
    if encoder not in ENCODERS:
        raise InputError(f"{path}: has encoder {encoder!r}, which is unknown; there are {', '.join(ENCODERS)}")
    head = arrays.get("segmentation_head.0.weight")
    features = head.shape[0] if head is not None and head.ndim == 4 else 1
    # Initial weights would be thrown away: only their shapes are worked out.
    network = nnx.eval_shape(lambda: GuideNetwork(encoder, features, rngs=nnx.Rngs(0)))
    assign(network, arrays, path)
    network.eval()
    return network, metadata


@checked_arguments
def kappa_of(metadata: Mapping[str, str], path: str | os.PathLike[str]) -> float:
    """The κ that goes with the features of a file's network."""
    if (norm := metadata.get("norm", "l2")) != "l2":
        raise InputError(f"{path}: trained for the norm {norm!r}; guides are read with 'l2'")
    try:
        kappa = float(metadata.get("kappa", "1"))
    except ValueError:
        kappa = 0.0
    if not 0 < kappa < float("inf"):
        raise InputError(f"{path}: its kappa is {metadata['kappa']!r}; it must be a number > 0")
    return kappa


@checked_arguments
def load_weights(path: str | os.PathLike[str], network: GuideNetwork) -> dict[str, str]:
    """Fill a network with the weights of a file, and return the file's metadata.

    Args:
        path: as in `load_network`; or weights of a timm encoder alone, which then fill `network.encoder`.
        network: changed in place, and left alone if the file does not fit.

    Raises:
        InputError: the file cannot be read, or belongs to another network: names the first layer that differs.
    """
    arrays, metadata = read_weights(path)
    if not any(name.startswith(("encoder.", "decoder.")) for name in arrays):
        arrays = {f"encoder.model.{n}": a for n, a in arrays.items() if not n.startswith(CLASSIFIER)}
        names = [name for name in named_variables(network) if name.startswith("encoder.")]
    else:
        names = None
    assign(network, arrays, path, names)
    return metadata


def assign(
    network: GuideNetwork, arrays: Arrays, path: str | os.PathLike[str], names: list[str] | None = None
) -> None:
    """Fill a network, or those of its variables that `names` has, with arrays by their torch names."""
    variables = named_variables(network)
    variables = variables if names is None else {name: variables[name] for name in names}
    filled = {}
    for name, variable in variables.items():
        need = torch_shape(variable.shape)
        if name not in arrays:
            lacking = sum(other not in arrays for other in variables)
            raise InputError(
                f"{path}: weights of another network, or not whole: {lacking} of {len(variables)} tensors of "
                f"{network.encoder_name} are missing, first {name}"
            )
        if arrays[name].shape != need:
            raise InputError(
                f"{path}: weights of another network: {name} has shape {arrays[name].shape}, where "
                f"{network.encoder_name} with {network.features} features needs {need}"
            )
        if not jnp.issubdtype(arrays[name].dtype, jnp.floating):
            raise InputError(f"{path}: {name} holds {arrays[name].dtype}; weights are floating point")
        array = from_torch_layout(arrays[name].astype(np.float32))
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} is not finite")
        filled[name] = array
    if extra := [name for name in arrays if name not in variables]:
        raise InputError(
            f"{path}: weights of another network: {network.encoder_name} has no place for {len(extra)} tensors, "
            f"first {extra[0]}"
        )
    for name, variable in variables.items():
        variable.set_value(jnp.asarray(filled[name]))


def read_weights(path: str | os.PathLike[str]) -> tuple[Arrays, dict[str, str]]:
    """(arrays by name, metadata) of a safetensors file, without torch's counters."""
    file = _downloaded(os.fspath(path)) if os.fspath(path).startswith(HUB) else Path(path)
    arrays, metadata = read_tensors(file, os.fspath(path))
    # Networks trained in parallel by torch have every name prefixed.
    arrays = {name.removeprefix("module."): array for name, array in arrays.items()}
    return {name: array for name, array in arrays.items() if not name.endswith(COUNTER)}, metadata


def named_variables(network: GuideNetwork) -> dict[str, Any]:
    """The variables of a network by their torch names, in the order of its layers."""
    places: dict[tuple[Any, ...], tuple[Any, ...]] = {}
    for path, module in nnx.iter_modules(network):
        if isinstance(module, ConvNorm):
            places[*path, "conv"] = *path[:-1], module.names[0]
            places[*path, "norm"] = *path[:-1], module.names[1]
    named = {}
    for part in ("encoder", "decoder", "segmentation_head"):
        for (*layer, leaf), variable in nnx.to_flat_state(nnx.state(getattr(network, part))):
            place = ".".join(map(str, places.get((part, *layer), (part, *layer))))
            name = f"{place}.{LEAVES[str(leaf)]}"
            named[name.replace("encoder.", "encoder.model.", 1) if part == "encoder" else name] = variable
    return named


def to_torch_layout(array: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Kernels outputs first, k×k last."""
    return array.transpose(3, 2, 0, 1) if array.ndim == 4 else array


def from_torch_layout(array: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Kernels k×k first, outputs last."""
    return array.transpose(2, 3, 1, 0) if array.ndim == 4 else array


def torch_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of an array of ours in torch's layout."""
    return (shape[3], shape[2], shape[0], shape[1]) if len(shape) == 4 else tuple(shape)


def _recognised(path: str | os.PathLike[str], arrays: Arrays) -> str:
    """The encoder whose tensors have the file's names and shapes."""
    shapes = {name: array.shape for name, array in arrays.items() if name.startswith("encoder.")}
    for encoder in ENCODERS:
        network = nnx.eval_shape(lambda encoder=encoder: GuideNetwork(encoder, 1, rngs=nnx.Rngs(0)))
        own = {n: torch_shape(v.shape) for n, v in named_variables(network).items() if n.startswith("encoder.")}
        if own == shapes:
            return encoder
    raise InputError(f"{path}: weights of an unknown network; the encoder is none of {', '.join(ENCODERS)}")


def _downloaded(address: str) -> Path:
    try:
        from huggingface_hub import hf_hub_download
    except ImportError:
        raise InputError(f"{address}: needs the package huggingface_hub; pip install it, or give a file") from None
    parts = address.removeprefix(HUB).split("/", 2)
    if len(parts) != 3 or not all(parts):
        raise InputError(f"{address}: must be {HUB}OWNER/NAME/FILE")
    try:
        return Path(hf_hub_download("/".join(parts[:2]), parts[2]))
    except Exception as error:  # of many kinds: network, permission, no such file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{address}: cannot be fetched ({reason})") from None
