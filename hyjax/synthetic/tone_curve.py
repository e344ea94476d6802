"""Tone curve of a camera and sRGB's encoding, in NumPy."""

import numpy as np
from jaxtyping import Float


def tone(x: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Tone curve with a shoulder: linear in the shadows, bending from 0.55, white at 3 times the mid exposure."""
    knee = 0.50
    over = np.maximum(x - knee, 0)
    return np.minimum(np.where(x < knee, x, knee + (1 - knee) * (1 - np.exp(-over / (1 - knee) * 1.0))), 1.0)


def encode(linear: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Linear light → sRGB, at most 1."""
    return encode_unclipped(np.minimum(linear, 1))


def encode_unclipped(linear: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Linear light → values on sRGB's curve, which goes on beyond white."""
    x = np.maximum(linear, 0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 1e-9), 1 / 2.4) - 0.055)
