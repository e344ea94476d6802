"""Random camera: exposure, lens, sensor, tone curve and compression."""

import io

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.ndimage import gaussian_filter, uniform_filter1d

from hyjax.synthetic.tone_curve import encode, tone
from hyjax.util.images import to_bytes


def develop(linear: Float[np.ndarray, "h w 3"], rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Develop linear light of any level to a display-encoded picture in 8-bit steps."""
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
    """Rounded by a JPEG file whose tables are `coarseness` times the usual ones."""
    quality = 50 / coarseness if coarseness > 1 else 100 - 50 * coarseness
    file = io.BytesIO()
    picture = Image.fromarray(to_bytes(display))
    picture.save(file, "JPEG", quality=round(quality), subsampling=0)
    return np.asarray(Image.open(file), np.float32) / 255
