"""Colour profiles of pictures: phones save in Display P3, and all else here takes pictures for sRGB."""

import functools
import io
import logging
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageCms

MOST_PROFILE_BYTES = 1 << 22
"""Largest profile that is looked at."""
_log = logging.getLogger(__name__)


def to_srgb(pixels: UInt8[np.ndarray, "h w c"], profile: bytes) -> UInt8[np.ndarray, "h w c"]:
    """Turn an 8-bit picture of a profile into sRGB; what lies outside is clipped.

    Args:
        pixels: display-encoded, of three channels, or four with the last one left alone. Other numbers of channels
            are no colours, and come back as they are.
        profile: ICC profile. Pictures of one that cannot be used are taken for sRGB, and a line says so once.
    """
    if pixels.shape[2] not in (3, 4) or (transform := _transform(profile)) is None:
        return pixels
    converted = ImageCms.applyTransform(Image.fromarray(np.ascontiguousarray(pixels[..., :3])), transform)
    return np.concatenate([np.asarray(converted), pixels[..., 3:]], axis=-1)


@functools.lru_cache(maxsize=8)
def _transform(profile: bytes) -> Any:
    """Transform of a profile into sRGB; None for sRGB itself, and for profiles that cannot be used."""
    try:
        if len(profile) > MOST_PROFILE_BYTES:
            raise ValueError("it is too large")
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if "srgb" in ImageCms.getProfileDescription(opened).lower():
            return None
        return ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), "RGB", "RGB")
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        _log.warning("a picture's colour profile cannot be used (%s): it is taken for sRGB", error)
        return None
