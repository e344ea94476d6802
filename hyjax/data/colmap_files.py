"""COLMAP's binary files: whether their counts fit their sizes, and the arrays of its dense reconstruction.

pycolmap trusts the counts of a damaged file and asks for any amount of memory, hence they are checked first.

Source: colmap.github.io/format.html.
"""

import struct

import numpy as np
from jaxtyping import Float

from hyjax.util.errors import InputError

LARGEST_SIDE = 65536


def check_binary(part: str, content: bytes, where: str) -> None:
    """Raise `InputError` unless the counts in a model's file fit its size.

    Args:
        part: cameras, images or points3D.
    """
    after = {"cameras": _after_camera, "images": _after_image, "points3D": _after_point}[part]
    try:
        (count,) = struct.unpack_from("<Q", content)
        at = 8
        for _ in range(count):
            at = after(content, at)
            if at > len(content):
                break
    except (struct.error, ValueError):
        at = len(content) + 1
    if at > len(content):
        raise InputError(f"{where}: ends within its {part}; truncated or damaged")


def _after_camera(content: bytes, at: int) -> int:
    model, width, height = struct.unpack_from("<i2Q", content, at + 4)
    if not 0 <= model < len(PARAMETERS) or max(width, height) > LARGEST_SIDE:
        raise ValueError(model)
    return at + 24 + 8 * PARAMETERS[model]


def _after_image(content: bytes, at: int) -> int:
    end = content.index(b"\0", at + 64)
    (points,) = struct.unpack_from("<Q", content, end + 1)
    return end + 9 + 24 * points


def _after_point(content: bytes, at: int) -> int:
    (track,) = struct.unpack_from("<Q", content, at + 43)
    return at + 51 + 8 * track


PARAMETERS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2)
"""Number of parameters of the camera models by their number, SIMPLE_PINHOLE first."""


def read_array(content: bytes, where: str) -> Float[np.ndarray, "h w"]:
    """A depth map of COLMAP's dense reconstruction: `width&height&1&`, then float32 row by row."""
    head = content[:64].split(b"&", 3)
    try:
        width, height, channels = (int(word) for word in head[:3])
    except ValueError:
        raise InputError(f"{where}: does not begin with width&height&channels&") from None
    start = sum(len(word) + 1 for word in head[:3])
    if channels != 1 or not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise InputError(f"{where}: {width}x{height} with {channels} channels is no depth map")
    if len(content) - start != 4 * width * height:
        raise InputError(f"{where}: {len(content) - start} bytes of depth are not those of {width}x{height}")
    return np.frombuffer(content, "<f4", offset=start).reshape(height, width).astype(np.float32)
