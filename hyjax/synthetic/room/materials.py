"""Table of materials, and trilinear lookup of their textures."""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, Int

from hyjax.synthetic.room import patterns
from hyjax.synthetic.surface import rows

Image = Float[np.ndarray, "n n 3"]


@dataclasses.dataclass(frozen=True)
class Material:
    """Material, a row of the table.

    Attributes:
        paint: draws the square, repeating albedo texture.
        size: pixels along a side, a power of two.
        tile: metres along a side.
        gloss: strength of the mirror reflection, 1 for a clean dielectric.
        blur: of the mirror reflection, in pixels of a 640-pixel-wide picture.
    """

    paint: Callable[[int, np.random.Generator], Image]
    size: int
    tile: float
    gloss: float = 0.0
    blur: float = 0.0


MATERIALS = (
    Material(patterns.paint, 512, 2.6),
    Material(patterns.planks, 2048, 5.2, 0.45, 7.0),
    Material(patterns.wood, 1024, 1.6, 0.4, 5.0),
    Material(patterns.fabric, 512, 0.25),
    Material(patterns.stripes, 512, 0.5),
    Material(patterns.rug, 1024, 2.4),
    Material(patterns.books, 512, 0.64, 0.15, 4.0),
    Material(patterns.plain, 64, 1.0, 0.9, 1.5),
    Material(patterns.plain, 64, 1.0, 0.35, 5.0),
    Material(patterns.leaf, 256, 0.5, 0.3, 4.0),
    Material(patterns.soil, 256, 0.3),
    Material(patterns.picture, 512, 1.0, 0.7, 1.0),
    Material(patterns.weave, 512, 0.25),
    Material(patterns.pages, 128, 0.05),
)
(PAINT, FLOOR, WOOD, FABRIC, STRIPES, RUG, BOOK, CERAMIC, LACQUER, LEAF, SOIL, PICTURE, WEAVE, PAGES) = range(
    len(MATERIALS)
)
GLOSS = np.array([m.gloss for m in MATERIALS], dtype=np.float32)
BLUR = np.array([m.blur for m in MATERIALS], dtype=np.float32)
TILE = np.array([m.tile for m in MATERIALS], dtype=np.float32)


class Textures:
    """Textures of all materials with their mip levels in one array, so that one lookup serves mixed materials."""

    def __init__(self, seed: int, quality: float = 1.0) -> None:
        shift = max(0, round(np.log2(1 / quality)))
        levels, starts, at = [], [], 0

        def draw(row: int) -> Image:
            size = max(32, MATERIALS[row].size >> shift)
            image = MATERIALS[row].paint(size, np.random.default_rng((seed, row)))
            return np.clip(image, 0.0, 1.0, dtype=np.float32)

        with ThreadPoolExecutor(2) as pool:
            images = list(pool.map(draw, range(len(MATERIALS))))
        for image in images:
            start = []
            while True:
                levels.append(image.reshape(-1, 3))
                start.append(at)
                at += len(levels[-1])
                if len(image) == 1:
                    break
                image = (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4
            starts.append(start)
        self._pixels = np.concatenate(levels)
        self._last = np.array([len(s) - 1 for s in starts], dtype=np.int32)
        self._start = np.array([s + [s[-1]] * (16 - len(s)) for s in starts], dtype=np.int32)
        self.mean = np.array([self._pixels[s[-1]] for s in starts])
        self.gloss, self.blur = GLOSS, BLUR

    def __call__(
        self,
        material: Int[np.ndarray, "n"],
        uv: Float[np.ndarray, "n 2"],
        footprint: Float[np.ndarray, "n"],
    ) -> Float[np.ndarray, "n 3"]:
        """Linear albedo at `uv` (metres), filtered to `footprint` (metres a pixel)."""
        last = rows(self._last, material)
        texel = rows(TILE / np.exp2(self._last, dtype=np.float32), material)
        level = np.clip(np.log2(np.maximum(footprint / texel, 1e-6)), 0.0, last).astype(np.float32)
        low = np.minimum(level.astype(np.int32), last)
        unit = uv / rows(TILE, material)[:, None]
        fine = self._bilinear(material, unit, low, last)
        coarse = self._bilinear(material, unit, np.minimum(low + 1, last), last)
        return fine + (coarse - fine) * (level - low)[:, None]

    def _bilinear(self, material: np.ndarray, unit: np.ndarray, level: np.ndarray, last: np.ndarray) -> np.ndarray:
        n = np.left_shift(1, last - level, dtype=np.int32)
        x, y = (unit * n.astype(np.float32)[:, None] - np.float32(0.5)).T
        x0, y0 = np.floor(x), np.floor(y)
        fx, fy = (x - x0)[:, None], (y - y0)[:, None]
        i0, j0 = x0.astype(np.int32), y0.astype(np.int32)
        start = rows(self._start.ravel(), 16 * material + level)
        mask = n - 1
        left, right = i0 & mask, (i0 + 1) & mask
        top, bottom = start + (j0 & mask) * n, start + ((j0 + 1) & mask) * n
        p = self._pixels
        upper = rows(p, top + left) * (1 - fx) + rows(p, top + right) * fx
        lower = rows(p, bottom + left) * (1 - fx) + rows(p, bottom + right) * fx
        return upper * (1 - fy) + lower * fy
