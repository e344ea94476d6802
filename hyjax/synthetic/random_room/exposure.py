"""A random camera: exposure, lens, sensor, tone curve and compression."""

import numpy as np
import scipy.fft
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, uniform_filter1d

from hyjax.synthetic.tone_curve import encode, tone

# ITU-T T.81, Annex K: the usual steps of luminance for a JPEG file's 8 × 8 coefficients.
JPEG_STEPS = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61], [12, 12, 14, 19, 26, 58, 60, 55], [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62], [18, 22, 37, 56, 68, 109, 103, 77], [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101], [72, 92, 95, 98, 112, 100, 103, 99],
    ],
    dtype=np.float32,
)  # fmt: skip


def develop(linear: Float[np.ndarray, "h w 3"], rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Linear light of any level → display-encoded picture in 8-bit steps."""
    h, w, _ = linear.shape
    level = np.exp(np.log(linear.mean(axis=-1) + 1e-4).mean())
    image = linear * (0.2 / level * np.exp(rng.normal(0, 0.35)))
    image = np.minimum(image, 6.0)
    blur = rng.uniform(0.3, 0.8) if rng.random() < 0.75 else rng.uniform(0.8, 1.8)
    image = gaussian_filter(image, (blur, blur, 0), truncate=3)
    if rng.random() < 0.15:  # a moving camera
        image = uniform_filter1d(image, int(rng.integers(2, 6)), axis=int(rng.integers(2)))
    y, x = np.mgrid[0:h, 0:w].astype(np.float32)
    radius = ((x + 0.5) / w - 0.5) ** 2 + ((y + 0.5) / h - 0.5) ** 2
    image = image * (1 - rng.uniform(0, 0.7) * radius)[..., None]
    image *= (1 + rng.normal(0, 0.08, 3)).astype(np.float32)
    shot, read = 10 ** rng.uniform(-5, -3.3), 10 ** rng.uniform(-6.5, -4.5)
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    if rng.random() < 0.5:  # demosaicing and the camera's own filter leave noise in blotches
        grain = gaussian_filter(grain, (0.7, 0.7, 0)) * 2
    image = np.maximum(image + np.sqrt(shot * image + read).astype(np.float32) * grain, 0)
    display = encode(tone(image)).astype(np.float32)
    display += np.float32(rng.uniform(-0.1, 0.5)) * (display * display * (3 - 2 * display) - display)
    grey = display.mean(axis=-1, keepdims=True)
    display = grey + (display - grey) * np.float32(rng.uniform(0.6, 1.25))
    if rng.random() < 0.4:  # sharpened by the camera
        display += np.float32(rng.uniform(0.2, 0.9)) * (
            display - gaussian_filter(display, (1.0, 1.0, 0), truncate=2)
        )
    if rng.random() < 0.5:
        display = _compressed(display, 10 ** rng.uniform(-0.9, 0.25))
    return (np.round(np.clip(display, 0, 1) * 255) / 255).astype(np.float32)


def _compressed(display: Float[np.ndarray, "h w 3"], coarseness: float) -> Float[np.ndarray, "h w 3"]:
    """Rounded as a JPEG file rounds: coefficients of 8 × 8 blocks, colour three times as coarsely."""
    h, w, _ = display.shape
    padded = np.pad(display, ((0, -h % 8), (0, -w % 8), (0, 0)), mode="edge") * 255
    grey = padded @ np.array([0.299, 0.587, 0.114], np.float32)
    out = np.empty_like(padded)
    planes = [_rounded(p, JPEG_STEPS * coarseness * k) for p, k in (
        (grey, 1), (padded[..., 0] - grey, 3), (padded[..., 2] - grey, 3))]  # fmt: skip
    out[..., 0], out[..., 2] = planes[0] + planes[1], planes[0] + planes[2]
    out[..., 1] = planes[0] - (0.299 * planes[1] + 0.114 * planes[2]) / 0.587
    return out[:h, :w] / 255


def _rounded(plane: Float[np.ndarray, "h w"], steps: np.ndarray) -> Float[np.ndarray, "h w"]:
    h, w = plane.shape
    blocks = plane.reshape(h // 8, 8, w // 8, 8).transpose(0, 2, 1, 3)
    coefficients = scipy.fft.dctn(blocks, axes=(2, 3), norm="ortho")
    coefficients = np.round(coefficients / steps) * steps
    back = scipy.fft.idctn(coefficients, axes=(2, 3), norm="ortho")
    return back.transpose(0, 2, 1, 3).reshape(h, w).astype(np.float32)
