"""Repeating noise and pixel grids for procedural textures."""

import numpy as np
import scipy.fft
from jaxtyping import Float


def noise(n: int, along_u: float, along_v: float, rng: np.random.Generator) -> Float[np.ndarray, "n n"]:
    """Repeating Gaussian noise of unit deviation, smoothed over `along_u` × `along_v` pixels."""
    fu = scipy.fft.rfftfreq(n)[None, :].astype(np.float32)
    fv = scipy.fft.fftfreq(n)[:, None].astype(np.float32)
    keep = np.exp(-2 * np.pi**2 * ((along_u * fu) ** 2 + (along_v * fv) ** 2))
    spectrum = scipy.fft.rfft2(rng.standard_normal((n, n), dtype=np.float32), workers=2)
    field = scipy.fft.irfft2(spectrum * keep, s=(n, n), workers=2)
    return (field - field.mean()) / field.std()


def pixel_centres(n: int) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Coordinates (u, v) in [0, 1) of the pixels of a square picture."""
    at = (np.arange(n, dtype=np.float32) + 0.5) / n
    u, v = np.meshgrid(at, at)
    return u, v
