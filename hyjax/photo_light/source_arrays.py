"""Photo sources as arrays, to be kept in a file, and back."""

import numpy as np

from hyjax.photo_light.sources import PhotoLamp, PhotoSources, PhotoWindow
from hyjax.util.cache import Arrays


def sources_to_arrays(sources: PhotoSources) -> Arrays:
    """Arrays of sources, for `sources_from_arrays`."""
    windows, lamps = sources.windows, sources.lamps
    return {
        "origin": np.array(sources.origin),
        "window_names": np.array([w.name for w in windows], str),
        "windows": np.array([(w.center, w.right, w.up, w.normal) for w in windows], float).reshape(-1, 4, 3),
        "lamp_names": np.array([lamp.name for lamp in lamps], str),
        "lamps": np.array([(*lamp.position, lamp.radius) for lamp in lamps], float).reshape(-1, 4),
    }


def sources_from_arrays(arrays: Arrays) -> PhotoSources:
    """Sources from the arrays of `sources_to_arrays`."""
    windows = tuple(
        PhotoWindow(str(name), *sides)
        for name, sides in zip(arrays["window_names"], arrays["windows"], strict=True)
    )
    lamps = tuple(
        PhotoLamp(str(name), place[:3], float(place[3]))
        for name, place in zip(arrays["lamp_names"], arrays["lamps"], strict=True)
    )
    return PhotoSources(windows, lamps, arrays["origin"].item())
