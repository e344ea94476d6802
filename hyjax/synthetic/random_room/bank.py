"""Bank of patterns with their mip levels, drawn once and looked up with filtering."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from hyjax.synthetic.random_room import patterns
from hyjax.synthetic.surface import rows


@dataclasses.dataclass(frozen=True)
class Family:
    """Family of patterns: its painter, its number of variants, pixels and usual metres along a side."""

    paint: Callable[[int, np.random.Generator], np.ndarray]
    count: int
    size: int
    tile: tuple[float, float]


FAMILIES = {
    "plain": Family(patterns.plain, 2, 64, (1.0, 3.0)),
    "clouds": Family(patterns.clouds, 8, 256, (0.2, 1.5)),
    "grain": Family(patterns.grain, 8, 512, (0.6, 1.6)),
    "planks": Family(patterns.planks, 6, 512, (0.8, 2.4)),
    "tiles": Family(patterns.tiles, 10, 256, (0.3, 1.6)),
    "stones": Family(patterns.stones, 8, 256, (0.3, 1.5)),
    "stripes": Family(patterns.stripes, 8, 256, (0.08, 0.6)),
    "checks": Family(patterns.checks, 8, 256, (0.08, 0.5)),
    "dots": Family(patterns.dots, 8, 256, (0.1, 0.5)),
    "zigzag": Family(patterns.zigzag, 6, 256, (0.1, 0.5)),
    "weave": Family(patterns.weave, 6, 256, (0.1, 0.4)),
    "gradient": Family(patterns.gradient, 4, 64, (0.3, 2.0)),
    "curves": Family(patterns.curves, 6, 256, (0.15, 0.8)),
    "leaves": Family(patterns.leaves, 14, 256, (0.2, 0.6)),
    "text": Family(patterns.text, 10, 512, (0.2, 0.3)),
    "pack": Family(patterns.pack, 20, 512, (0.2, 0.4)),
    "motif": Family(patterns.motif, 8, 256, (0.15, 0.6)),
    "rug": Family(patterns.rug, 6, 256, (0.5, 2.0)),
    "speckle": Family(patterns.speckle, 6, 256, (0.08, 0.6)),
}


def painted(seed: int) -> dict[str, list[np.ndarray]]:
    """Paint the patterns of every family, as shares of three colours."""
    return {
        name: [
            np.clip(family.paint(family.size, np.random.default_rng((seed, row, number))), 0, 1).astype(np.float32)
            for number in range(family.count)
        ]
        for row, (name, family) in enumerate(FAMILIES.items())
    }


class Bank:
    """Bank of all patterns with their mip levels, in one array of 8-bit pixels.

    Args:
        images: square patterns of each family; their sides are powers of two.

    Attributes:
        family: the patterns of each family.
    """

    def __init__(self, images: dict[str, list[np.ndarray]]) -> None:
        levels: list[np.ndarray] = []
        starts: list[list[int]] = []
        sizes: list[int] = []
        at = 0
        self.family: dict[str, range] = {}
        for name, family in images.items():
            self.family[name] = range(len(starts), len(starts) + len(family))
            for image in family:
                start = []
                sizes.append(int(np.log2(len(image))))
                while True:
                    levels.append(np.round(image * 255).astype(np.uint8).reshape(-1, 3))
                    start.append(at)
                    at += len(levels[-1])
                    if len(image) == 1:
                        break
                    image = (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4
                starts.append(start + [start[-1]] * (10 - len(start)))
        self._pixels = np.concatenate(levels)
        self._start = np.array(starts, dtype=np.int32)
        self._last = np.array(sizes, dtype=np.int32)
        self.mean = np.array([self._pixels[s[k]] / 255 for s, k in zip(starts, sizes)], dtype=np.float32)

    def shares(
        self, pattern: Int[np.ndarray, "n"], unit: Float[np.ndarray, "n 2"], width: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Look up the pattern at `unit` (repeating with 1), filtered to `width` (a share of the tile)."""
        last = rows(self._last, pattern)
        level = np.clip(np.round(np.log2(np.maximum(width, 1e-6)) + last), 0, last).astype(np.int32)
        n = np.left_shift(1, last - level, dtype=np.int32)
        x, y = (unit * n.astype(np.float32)[:, None] - np.float32(0.5)).T
        x0, y0 = np.floor(x), np.floor(y)
        fx, fy = (x - x0)[:, None], (y - y0)[:, None]
        i0, j0 = x0.astype(np.int32), y0.astype(np.int32)
        start = rows(self._start.ravel(), self._start.shape[1] * pattern + level)
        mask = n - 1
        left, right = i0 & mask, (i0 + 1) & mask
        top, bottom = start + (j0 & mask) * n, start + ((j0 + 1) & mask) * n
        p = self._pixels
        a, b, c, d = (
            rows(p, k).astype(np.float32) for k in (top + left, top + right, bottom + left, bottom + right)
        )
        upper = a + (b - a) * fx
        return (upper + (c + (d - c) * fx - upper) * fy) * np.float32(1 / 255)
