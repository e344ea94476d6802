"""Looks of surfaces: random palettes over patterns from a bank."""

import colorsys
import dataclasses

import numpy as np
from jaxtyping import Float, Int

from hyjax.synthetic.random_room.bank import FAMILIES, Bank
from hyjax.synthetic.surface import rows


@dataclasses.dataclass(frozen=True)
class Role:
    """Role of a surface: the range of its looks.

    Attributes:
        families: of patterns, with weights.
        colors: scheme of its palette.
        gloss: (share of glossy ones, strength of their mirror image).
    """

    families: dict[str, float]
    colors: str
    gloss: tuple[float, float] = (0.0, 0.0)


PHOTOGRAPHS = "photographs"
"""Name of a further family of the bank: pictures of other rooms, linear red, green and blue."""

_CLOTH = {"plain": 2, "weave": 3, "stripes": 2, "checks": 2, "dots": 1, "zigzag": 1, "motif": 2, "clouds": 0.5}
_PRINT = {
    "pack": 4,
    "leaves": 0.7,
    PHOTOGRAPHS: 0.7,
    "stripes": 0.5,
    "dots": 0.5,
    "gradient": 0.5,
    "plain": 0.7,
    "motif": 0.5,
}
ROLES = {
    "wall": Role({"plain": 6, "stripes": 1, "motif": 1, "tiles": 1.2, "clouds": 1, "grain": 0.5, "speckle": 0.5,
                  "gradient": 0.5, "curves": 0.3, "checks": 0.3, "zigzag": 0.3}, "wall"),
    "ceiling": Role({"plain": 6, "tiles": 1, "planks": 0.5}, "pale"),
    "floor": Role({"planks": 4, "tiles": 2.5, "speckle": 1.5, "stones": 1, "plain": 1, "weave": 0.7, "stripes": 0.8,
                   "clouds": 0.7, "checks": 0.4}, "floor", (0.5, 0.6)),
    "rug": Role({"rug": 5, "stripes": 1, "weave": 1, "speckle": 1, "motif": 1, "zigzag": 1}, "any"),
    "wood": Role({"grain": 6, "planks": 0.6, "plain": 0.7, "speckle": 0.3}, "wood", (0.6, 0.4)),
    "front": Role({"grain": 3, "plain": 4, "stripes": 0.3, "tiles": 0.2}, "furniture", (0.5, 0.7)),
    "worktop": Role({"grain": 4, "speckle": 2, "plain": 1.5, "clouds": 1.5, "tiles": 1}, "furniture",
                    (0.6, 0.6)),
    "cloth": Role(_CLOTH, "any"),
    "lacquer": Role({"plain": 6, "grain": 0.5, "speckle": 0.5}, "furniture", (0.5, 0.5)),
    "glazed": Role({"plain": 4, "gradient": 1, "stripes": 1, "dots": 0.5, "motif": 0.7, "clouds": 0.7}, "any",
                   (0.8, 0.9)),
    "plastic": Role({"plain": 5, "gradient": 1, "pack": 1, "speckle": 0.3}, "any", (0.6, 0.6)),
    "metal": Role({"plain": 4, "clouds": 1, "speckle": 0.5}, "grey", (0.9, 3.0)),
    "print": Role(_PRINT, "bright", (0.4, 0.4)),
    "photo": Role({PHOTOGRAPHS: 4, "leaves": 2, "motif": 0.6, "curves": 0.6, "pack": 0.8}, "bright", (0.5, 0.6)),
    "paper": Role({"text": 5, "plain": 1, "curves": 0.6, "pack": 0.6}, "paper"),
    "page": Role({"stripes": 1, "plain": 2}, "pale"),
    "screen": Role({"text": 1, PHOTOGRAPHS: 1.5, "leaves": 0.5, "pack": 1, "plain": 3}, "screen", (1.0, 1.0)),
    "leaf": Role({"clouds": 2, "plain": 2, "stripes": 0.5}, "leaf", (0.6, 0.4)),
    "soil": Role({"speckle": 1}, "dark"),
}  # fmt: skip
ODD_SHARE = 0.05
"""Probability of a look with any pattern and colours."""
DETAILS = ("clouds", "speckle", "weave", "grain")
"""Families whose first colour's share is laid over other patterns as unevenness."""
SHARED_PALETTE = 0.18
"""Probability of borrowing the palette of another look in the room, which gives borders of low contrast."""


def _color(hue: float, saturation: float, value: float) -> np.ndarray:
    """Linear albedo of a display colour."""
    saturation, value = (float(np.clip(x, 0, 1)) for x in (saturation, value))
    # Strong pigments swallow most of the light.
    display = np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value * (1 - 0.35 * saturation**2)))
    return np.clip(display**2.2, 0.012, 0.88)


def _ground(rng: np.random.Generator, scheme: str) -> tuple[float, float, float]:
    """Draw hue, saturation and value of a palette's first colour."""
    u = rng.uniform
    kind = rng.random()
    if scheme == "wood":
        return u(0.04, 0.12), u(0.15, 0.7), u(0.25, 0.95)
    if scheme == "grey":
        return u(0, 1), u(0, 0.08), u(0.15, 0.9)
    if scheme in ("pale", "paper") or (scheme == "wall" and kind < 0.55):
        return u(0.02, 0.2) if kind < 0.4 else u(0, 1), u(0, 0.12), u(0.78, 0.97)
    if scheme == "wall":
        return u(0, 1), u(0.05, 0.35) if kind < 0.88 else u(0.3, 0.75), u(0.4, 0.9)
    if scheme == "floor":
        return (u(0.04, 0.12), u(0.1, 0.65), u(0.25, 0.9)) if kind < 0.6 else (u(0, 1), u(0, 0.2), u(0.15, 0.85))
    if scheme == "furniture" and kind < 0.75:
        return (u(0.04, 0.12), u(0.15, 0.7), u(0.25, 0.9)) if kind < 0.3 else (u(0, 1), u(0, 0.12), u(0.1, 0.95))
    if scheme == "leaf":
        return u(0.18, 0.38), u(0.3, 0.8), u(0.2, 0.6)
    if scheme == "dark":
        return u(0, 0.15), u(0, 0.6), u(0.08, 0.3)
    if scheme == "screen":
        return u(0, 1), u(0, 0.4), u(0.05, 0.12) if kind < 0.5 else u(0.3, 0.9)
    if scheme == "any" and kind < 0.35:
        return u(0, 1), u(0, 0.25), u(0.1, 0.95)
    return u(0, 1), u(0.2, 0.9), u(0.2, 0.95)


def _primaries(rng: np.random.Generator) -> Float[np.ndarray, "4 3"]:
    """Black, red, green and blue as inks of some strength."""
    inks = np.eye(4, 3, -1) * rng.uniform(0.5, 0.9, 3)
    grey = inks.sum(axis=1, keepdims=True) / 3
    return (inks + (grey - inks) * rng.choice([0.0, 0.3, 1.0], p=[0.5, 0.35, 0.15]) + 0.012).astype(np.float32)


def palette(rng: np.random.Generator, scheme: str) -> Float[np.ndarray, "4 3"]:
    """Draw a palette of four linear albedos."""
    hue, saturation, value = _ground(rng, scheme)
    tonal = {"wood": 0.95, "floor": 0.8, "wall": 0.75, "bright": 0.1, "leaf": 0.9}.get(scheme, 0.5)
    colors = [_color(hue, saturation, value)]
    same = rng.random() < tonal
    contrast = rng.uniform(0.1, 0.7)
    for k in range(3):
        if scheme == "paper":
            dark = rng.random() < 0.7
            colors.append(_color(rng.random(), 0.1 if dark else 0.7, rng.uniform(0.05, 0.3 if dark else 0.8)))
        elif same:
            # Away from the nearer end of the scale of brightness.
            change = rng.uniform(0.2, 1) * contrast * (-1 if value > 0.5 else 1)
            colors.append(_color(hue + rng.normal(0, 0.02), saturation + rng.normal(0, 0.1), value + change))
        else:
            other = _ground(rng, "any" if scheme in ("grey", "pale", "wall") or k == 2 else scheme)
            colors.append(_color(*other))
    return np.array(colors, dtype=np.float32)


class Looks:
    """Looks of one room."""

    def __init__(self, patterns: Bank) -> None:
        self.patterns = patterns
        self._rows: list[tuple] = []
        self._palettes: list[np.ndarray] = []
        self._table: tuple[np.ndarray, ...] | None = None

    def draw(self, rng: np.random.Generator, role: str, tile: float | None = None) -> int:
        """Draw a new look and return its number.

        Args:
            tile: metres along a side of the pattern; None for the usual size.
        """
        kind = ROLES[role]
        odd = rng.random() < ODD_SHARE
        families = dict.fromkeys(FAMILIES, 1.0) if odd else kind.families
        names = [name for name in families if name in self.patterns.family]
        weights = np.array([families[name] for name in names])
        name = names[rng.choice(len(names), p=weights / weights.sum())]
        pattern = int(rng.choice(self.patterns.family[name]))
        colors = palette(rng, "any" if odd else kind.colors)
        if name == PHOTOGRAPHS:
            colors = _primaries(rng)
        elif self._palettes and role not in ("leaf", "soil", "paper", "screen") and rng.random() < SHARED_PALETTE:
            colors = self._palettes[rng.integers(len(self._palettes))] * rng.uniform(0.85, 1.15, 3)
        low, high = FAMILIES[name].tile if name in FAMILIES else (0.2, 0.6)
        size = tile if tile is not None else low * (high / low) ** rng.random()
        turn = 0.0 if tile is not None or rng.random() < 0.7 else rng.uniform(0, 2 * np.pi)
        if tile is None and name in ("stripes", "zigzag") and rng.random() < 0.5:
            turn = np.pi / 2
        shift = np.zeros(2) if tile is not None else rng.random(2)
        fine = [name for name in DETAILS if name in self.patterns.family]
        detail = int(rng.choice(self.patterns.family[fine[rng.integers(len(fine))]]))
        amount = 0.0 if rng.random() < 0.4 else rng.uniform(0.05, 0.35)
        share, strength = kind.gloss
        glossy = rng.random() < share
        gloss = strength * rng.uniform(0.3, 1.3) if glossy else 0.0
        shine = 10 ** rng.uniform(1.0, 2.7)
        c, s = np.cos(turn) / size, np.sin(turn) / size
        self._rows.append((pattern, (c, -s, s, c), shift, detail, rng.uniform(0.05, 0.8), amount, gloss, shine))
        self._palettes.append(colors)
        self._table = None
        return len(self._rows) - 1

    def _columns(self) -> tuple[np.ndarray, ...]:
        if self._table is None:
            pattern, matrix, shift, detail, detail_tile, amount, gloss, shine = zip(*self._rows)
            colors = np.stack(self._palettes).astype(np.float32)
            colors[:, 1:] -= colors[:, :1]
            mean = colors[:, 0] + np.einsum("lk,lkc->lc", self.patterns.mean[list(pattern)], colors[:, 1:])
            floats = (matrix, shift, detail_tile, amount, gloss, shine, mean)
            self._table = (
                np.array(pattern, dtype=np.int32), np.array(detail, dtype=np.int32),
                colors.reshape(-1, 12), *(np.array(f, dtype=np.float32) for f in floats),
            )  # fmt: skip
        return self._table

    def albedo(
        self, look: Int[np.ndarray, "n"], uv: Float[np.ndarray, "n 2"], footprint: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Linear albedo at `uv` (metres), filtered to `footprint` (metres a pixel)."""
        pattern, detail, colors, matrix, shift, detail_tile, amount, *_ = self._columns()
        m = rows(matrix, look)
        unit = np.stack([m[:, 0] * uv[:, 0] + m[:, 1] * uv[:, 1], m[:, 2] * uv[:, 0] + m[:, 3] * uv[:, 1]], -1)
        scale = np.hypot(m[:, 0], m[:, 1])
        share = self.patterns.shares(rows(pattern, look), unit + rows(shift, look), footprint * scale)
        c = rows(colors, look)
        albedo = c[:, :3] + share[:, :1] * c[:, 3:6] + share[:, 1:2] * c[:, 6:9] + share[:, 2:] * c[:, 9:]
        some = np.flatnonzero(rows(amount, look) > 0)
        which, tile = look[some], rows(detail_tile, look[some])
        overlay = rows(detail, which)
        grain = self.patterns.shares(overlay, uv[some] / tile[:, None], footprint[some] / tile)[:, :1]
        albedo[some] *= 1 + rows(amount, which)[:, None] * (grain - rows(self.patterns.mean, overlay)[:, :1]) * 2
        return np.clip(albedo, 0.008, 0.92)

    def mean(self, look: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Mean linear albedo."""
        return np.clip(rows(self._columns()[9], look), 0.008, 0.92)

    def gloss(self, look: Int[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Strength of the mirror image, and the exponent of highlights."""
        table = self._columns()
        return rows(table[7], look), rows(table[8], look)
