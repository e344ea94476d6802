"""State dicts that torch has saved, read without torch.

Such a file is a zip archive: a pickle of what was saved, in which every tensor is a call of a torch function, and a
file of raw numbers for each storage. A pickle can run any code; here it can build tensors and containers alone.

Source of the format: https://github.com/pytorch/pytorch/blob/v2.8.0/torch/serialization.py
"""

import collections
import io
import math
import pickle
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import ml_dtypes
import numpy as np
from jaxtyping import Shaped

from hyjax.util.errors import InputError
from hyjax.util.reading import check_regular

STORAGES = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "HalfStorage": np.float16,
    "BFloat16Storage": ml_dtypes.bfloat16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}
HARMLESS = 1 << 24
"""Bytes that any file may unpack to."""
LARGEST_RATIO = 8
"""Of the bytes of all tensors, and of what is unpacked, to those of the file; torch packs nothing."""
WRAPPERS = ("state_dict", "model_state_dict", "model")
"""Keys under which training programs keep a state dict beside other things."""


def read_state_dict(path: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Arrays by name from a `.pt` or `.pth` file.

    Args:
        path: file that `torch.save` wrote from a state dict, or from a dict that holds one as `state_dict`.

    Raises:
        InputError: no such file, a damaged one, or one that holds more than tensors.
    """
    check_regular(path)
    try:
        with zipfile.ZipFile(path) as archive:
            found = _Tensors(archive).load()
    except Exception as error:  # a damaged pickle can raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a state dict that torch has saved ({reason})") from None
    for key in WRAPPERS:
        if isinstance(found, Mapping) and isinstance(found.get(key), Mapping):
            found = found[key]
    if not isinstance(found, Mapping) or not any(isinstance(value, np.ndarray) for value in found.values()):
        raise InputError(f"{path}: holds no state dict; save one with torch.save(model.state_dict(), path)")
    return {str(name): value for name, value in found.items() if isinstance(value, np.ndarray)}


class _Tensors(pickle.Unpickler):
    """Builds arrays in plain containers and nothing else."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        pickles = [name for name in archive.namelist() if name.endswith("data.pkl")]
        if len(pickles) != 1:
            raise pickle.UnpicklingError("the archive has no data.pkl")
        self._left = HARMLESS + LARGEST_RATIO * sum(entry.compress_size for entry in archive.infolist())
        if sum(entry.file_size for entry in archive.infolist()) > self._left:
            raise pickle.UnpicklingError("it unpacks to far more than it is packed in")
        super().__init__(io.BytesIO(archive.read(pickles[0])))
        self._archive = archive
        self._folder = pickles[0].removesuffix("data.pkl")
        order = self._folder + "byteorder"
        self._order = ">" if order in archive.namelist() and archive.read(order) == b"big" else "<"

    def find_class(self, module: str, name: str) -> Any:
        allowed: dict[tuple[str, str], Callable[..., Any]] = {
            ("collections", "OrderedDict"): collections.OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2"): self._tensor,
            ("torch._utils", "_rebuild_parameter"): lambda data, *_: data,
        }
        if module == "torch" and name in STORAGES:
            return STORAGES[name]
        if (module, name) not in allowed:
            raise pickle.UnpicklingError(f"it holds a {module}.{name}, not only tensors")
        return allowed[module, name]

    def persistent_load(self, pid: Any) -> Shaped[np.ndarray, "n"]:
        _, kind, key, _, count = pid
        dtype = np.dtype(kind).newbyteorder(self._order) if np.dtype(kind).isbuiltin == 1 else np.dtype(kind)
        return np.frombuffer(self._archive.read(f"{self._folder}data/{key}"), dtype, count)

    def _tensor(
        self,
        storage: Shaped[np.ndarray, "n"],
        offset: int,
        shape: tuple[int, ...],
        strides: tuple[int, ...],
        *_: Any,
    ) -> Shaped[np.ndarray, "..."]:
        last = offset + sum((n - 1) * stride for n, stride in zip(shape, strides)) if 0 not in shape else offset - 1
        if offset < 0 or min((*shape, *strides), default=0) < 0 or last >= storage.size:
            raise pickle.UnpicklingError("a tensor reaches beyond its storage")
        self._left -= math.prod(shape) * storage.itemsize
        if self._left < 0:
            raise pickle.UnpicklingError("its tensors are far larger than the file")
        steps = [stride * storage.itemsize for stride in strides]
        return np.array(np.lib.stride_tricks.as_strided(storage[offset:], shape, steps))
