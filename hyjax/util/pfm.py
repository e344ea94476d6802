"""Portable float maps of one channel."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hyjax.util.errors import InputError
from hyjax.util.reading import read_bytes

PFM_HEADER = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+(-?[\d.eE+-]+)\s")


def read_pfm(path: Path) -> Float[np.ndarray, "h w"]:
    """Read a one-channel portable float map, unscaled: the scale in its header is not meant to be applied here."""
    content = read_bytes(path)
    header = PFM_HEADER.match(content)
    if header is None:
        raise InputError(f"{path}: not a one-channel PFM; its header must be Pf, width, height, scale")
    width, height = int(header[1]), int(header[2])
    order = "<" if header[3].startswith(b"-") else ">"
    values = content[header.end() :]
    if len(values) != 4 * width * height:
        raise InputError(f"{path}: has {len(values)} bytes of values, {width}x{height} need {4 * width * height}")
    return np.frombuffer(values, f"{order}f4").reshape(height, width)[::-1].astype(np.float32)
