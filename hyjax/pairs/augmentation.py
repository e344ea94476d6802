"""Random crops of pairs, with a camera's variation of their colours. All chance comes from the given generator."""

import io
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageFilter

RESCALING = (0.7, 1.4)
LEAST_VALID = 0.3
"""Least share of valid pixels of a crop; one with fewer is drawn again."""
DRAWS = 20
"""Most draws of a crop; then the best of them is taken."""
GAMMA = 2.2  # close enough to sRGB's curve for a camera that does not exist


class Packed(NamedTuple):
    """Pair in memory: 8 bits per colour and per component of the normals.

    Attributes:
        image: display-encoded colours, 255 for 1.
        depth: 0 where invalid.
        normal: 127 for 1; None if nowhere known.
        disparity: whether `depth` is a disparity.
    """

    image: UInt8[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    normal: np.ndarray | None
    disparity: bool

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return self.image.nbytes + self.depth.nbytes + (0 if self.normal is None else self.normal.nbytes)


class Crop(NamedTuple):
    """Square window of a pair, or a batch of them: code that depends on depth's unit must read `disparity`.

    Attributes:
        image: display-encoded colours in [0, 1], float32.
        depth: in metres or disparity, 0 where invalid, float32.
        valid: where the depth may be relied on.
        normal: unit vectors in camera axes towards the camera, 0 where unknown, float32.
        disparity: whether the depth is a disparity.
    """

    image: Float[np.ndarray, "*b s s 3"]
    depth: Float[np.ndarray, "*b s s"]
    valid: Bool[np.ndarray, "*b s s"]
    normal: Float[np.ndarray, "*b s s 3"]
    disparity: Bool[np.ndarray, "*b"] | np.bool_


def random_crop(pair: Packed, size: int, rng: np.random.Generator, augment: bool) -> Crop:
    """Cut a random square window of a pair, resampled to `size` × `size` pixels.

    Colours are averaged; depth and normals are taken from the nearest pixel, so that borders stay crisp. A pair
    smaller than the window is enlarged.

    Args:
        size: pixels.
        augment: whether to rescale, to mirror and to change colours.
    """
    height, width = pair.depth.shape
    scale = math.exp(rng.uniform(*np.log(RESCALING))) if augment else 1.0
    side = min(round(size / scale), height, width)
    best, most = (0, 0), -1.0
    for _ in range(DRAWS):
        top, left = (int(rng.integers(extent - side + 1)) for extent in (height, width))
        share = (
            np.count_nonzero(pair.depth[top : top + side : 4, left : left + side : 4]) / len(range(0, side, 4)) ** 2
        )
        if share > most:
            best, most = (top, left), share
        if share >= LEAST_VALID:
            break
    # The pixel that holds the centre of each output pixel.
    rows, columns = (start + (2 * np.arange(size) + 1) * side // (2 * size) for start in best)
    if mirrored := bool(augment and rng.integers(2)):
        columns = columns[::-1]
    pixels = pair.image[best[0] : best[0] + side, best[1] : best[1] + side]
    picture = Image.fromarray(np.ascontiguousarray(pixels[:, ::-1] if mirrored else pixels))
    if side != size:
        picture = picture.resize((size, size), Image.Resampling.BILINEAR)
    image = recolored(picture, rng) if augment else np.asarray(picture, dtype=np.float32) / 255
    depth = pair.depth[rows[:, None], columns]
    normal = np.zeros((size, size, 3), np.float32)
    if pair.normal is not None:
        normal = pair.normal[rows[:, None], columns].astype(np.float32)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
        if mirrored:
            normal[..., 0] *= -1
    return Crop(image, depth, depth > 0, normal, np.bool_(pair.disparity))


def recolored(picture: Image.Image, rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Vary the colours of a picture as another camera in other light would.

    In a camera's order: blur of the lens, exposure and white balance of linear light, contrast, saturation and
    hue, noise of the sensor, compression. Each is drawn anew; blur and compression happen now and then only.
    """
    if rng.random() < 0.3:
        picture = picture.filter(ImageFilter.GaussianBlur(rng.uniform(0.3, 1.5)))
    levels = np.arange(256, dtype=np.float32) / 255
    gains = np.exp2(rng.uniform(-1.0, 0.7) + rng.normal(0, 0.15, 3))
    contrast = math.exp(rng.uniform(-0.3, 0.3))
    curve = np.minimum(levels[:, None] ** GAMMA * gains, 1.0) ** (contrast / GAMMA)
    pixels = np.asarray(picture)
    image = np.stack([curve[:, c].astype(np.float32)[pixels[..., c]] for c in range(3)], axis=-1)
    image = image @ color_matrix(rng.uniform(0.0, 1.6), rng.normal(0, 0.15)).T
    sigma = rng.exponential(0.015)
    image += np.float32(sigma) * rng.standard_normal(image.shape, dtype=np.float32)
    image = np.clip(image, 0.0, 1.0)
    if rng.random() < 0.4:
        packed = io.BytesIO()
        Image.fromarray((image * 255 + 0.5).astype(np.uint8)).save(
            packed, "jpeg", quality=int(rng.integers(25, 95))
        )
        image = np.asarray(Image.open(packed), dtype=np.float32) / 255
    return image


def color_matrix(saturation: float, hue: float) -> Float[np.ndarray, "3 3"]:
    """Colour matrix: distance from grey times `saturation`, rotated about grey by `hue` radians."""
    grey = np.full((3, 3), 1 / 3)
    across = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) / math.sqrt(3)
    turned = math.cos(hue) * (np.eye(3) - grey) + math.sin(hue) * across
    return (grey + saturation * turned).astype(np.float32)
