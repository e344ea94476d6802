"""Arrays of safetensors files, which may come from strangers."""

from pathlib import Path

import numpy as np
import safetensors

from hyjax.util.errors import InputError
from hyjax.util.reading import check_most, open_regular

LARGEST_FILE = 1 << 30
"""Bytes of a file."""
LARGEST_HEADER = 1 << 20
"""Bytes of names, shapes and texts: 31 KiB of them for the small guide; 76 MiB take 17 s and 1.8 GiB."""


def read_tensors(path: Path, where: str | None = None) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """(arrays by name, texts by name) of a safetensors file."""
    where = where or str(path)
    with open_regular(path, where) as file:
        check_most(file.seek(0, 2), LARGEST_FILE, where)
        file.seek(0)
        size = int.from_bytes(file.read(8), "little")
    reason = ""
    if size > LARGEST_HEADER:
        reason = "its header is too large"
    else:
        try:
            with safetensors.safe_open(path, framework="numpy") as opened:
                arrays = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118, no mapping
                return arrays, opened.metadata() or {}
        except Exception as error:  # SafetensorError, OSError, KeyError, …: of a damaged header
            reason = " ".join(str(error).split()) or type(error).__name__
    raise InputError(
        f"{where}: not safetensors, or damaged ({reason}); in a clone, python -m experiments.convert_weights "
        "makes safetensors of other files"
    )
