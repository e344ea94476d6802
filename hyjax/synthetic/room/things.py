"""Small things: books, crockery, plants, pictures, boxes. Local axes, standing on z = 0."""

import numpy as np

from hyjax.synthetic.room import materials as m
from hyjax.synthetic.shapes import box, panel, revolve, sheet, tube
from hyjax.synthetic.surface import WHITE, Builder, Color

COVERS: tuple[Color, ...] = (
    (0.45, 0.07, 0.05), (0.06, 0.13, 0.28), (0.08, 0.20, 0.12), (0.60, 0.42, 0.10), (0.70, 0.66, 0.56),
    (0.10, 0.10, 0.11), (0.42, 0.20, 0.10), (0.16, 0.30, 0.36), (0.55, 0.24, 0.18), (0.75, 0.73, 0.70),
    (0.20, 0.09, 0.13), (0.35, 0.38, 0.20),
)  # fmt: skip
GLAZES: tuple[Color, ...] = ((0.72, 0.70, 0.66), (0.10, 0.22, 0.33), (0.50, 0.22, 0.12), (0.25, 0.36, 0.30))


def _cover(build: Builder) -> Color:
    r, g, b = np.clip(np.array(COVERS[build.rng.integers(len(COVERS))]) * build.rng.uniform(0.8, 1.25), 0, 0.85)
    grey = 0.12 * (r + g + b) / 3
    return float(0.88 * r + grey), float(0.88 * g + grey), float(0.88 * b + grey)


def book(build: Builder, thick: float, deep: float, tall: float) -> None:
    """A standing book: spine at y = -deep, thickness along x from 0, cover boards proud of the pages."""
    spine = (build.rng.integers(16) * 0.04 + 0.02 - thick / 2, 0.0)
    cover, board = _cover(build), 0.0025
    box(build, (0, -deep, 0), (thick, -deep + 0.004, tall), m.BOOK, cover, 0.001, "x", spine, 0.03)
    for low, high in ((0.0, board), (thick - board, thick)):
        box(build, (low, -deep + 0.004, 0), (high, 0, tall), m.BOOK, cover, 0.0, "y", (0.3, 0.3), 0.07)
    box(build, (board, -deep + 0.004, 0.004), (thick - board, -0.004, tall - 0.004), m.PAGES, WHITE, 0.0, "z",
        texel=0.08)  # fmt: skip


def book_row(build: Builder, start: float, end: float, z: float, room: float) -> None:
    """Books side by side along x until `end`, none higher than `room`."""
    x = start
    while True:
        thick, tall = build.rng.uniform(0.014, 0.040), min(build.rng.uniform(0.17, 0.29), room)
        if x + thick > end:
            return
        with build.placed(x, build.rng.uniform(-0.05, -0.02), z):
            book(build, thick, min(0.72 * tall, 0.2), tall)
        x += thick + 0.0008


def book_stack(build: Builder, count: int) -> None:
    """Books lying on each other, each turned a little."""
    z, plain = 0.0, (0.3, 0.3)
    for k in range(count):
        thick, x, y = build.rng.uniform(0.018, 0.035), 0.125 - 0.01 * k, 0.09 - 0.0075 * k
        cover, top = _cover(build), thick - 0.003
        with build.placed(0, 0, z, build.rng.uniform(-14, 14)):
            box(build, (-x, -y, 0), (x, y, 0.003), m.BOOK, cover, 0.0008, "y", plain)
            box(build, (-x, -y, top), (x, y, thick), m.BOOK, cover, 0.0008, "y", plain)
            box(build, (-x, -y, 0.003), (x, 0.003 - y, top), m.BOOK, cover, 0.0, "z", plain)
            low, high = (0.004 - x, 0.003 - y, 0.003), (x - 0.004, y - 0.004, top)
            box(build, low, high, m.PAGES, WHITE, 0.0, "x", texel=0.05)
        z += thick


def vase(build: Builder, tall: float, tint: Color) -> None:
    """A glazed vase with a narrow neck, hollow at the top."""
    z = np.linspace(0, 1, 25)
    radius = 0.30 * np.sin(np.pi * np.clip(z * 0.80 + 0.13, 0, 1)) ** 1.2 + 0.06 + 0.09 * z**8
    outer = [(r * tall, k * tall) for r, k in zip(radius, z)]
    inner = [(r - 0.005, k) for r, k in outer[:14:-1]]
    revolve(build, [(0, 0), (outer[0][0] - 0.002, 0), *outer, *inner, (0, inner[-1][1] - 0.01)], m.CERAMIC, tint,
            40)  # fmt: skip


def bowl(build: Builder, radius: float, tint: Color) -> None:
    """An open bowl on a foot."""
    angle = np.linspace(0.18, 1.0, 14) * np.pi / 2
    outer = [(radius * np.sin(a), 0.55 * radius * (1 - np.cos(a)) + 0.008) for a in angle]
    inner = [(r * 0.96, z + 0.005) for r, z in outer[::-1]]
    revolve(build, [(0, 0), (outer[0][0], 0), (outer[0][0] + 0.002, 0.001), *outer,
                    (outer[-1][0] * 0.985, outer[-1][1] + 0.005), *inner, (0, inner[-1][1])],
            m.CERAMIC, tint, 48)  # fmt: skip


def mug(build: Builder, tint: Color) -> None:
    """A mug with a handle."""
    revolve(build, [(0, 0), (0.036, 0), (0.039, 0.002), (0.041, 0.006), (0.042, 0.09), (0.0415, 0.093),
                    (0.039, 0.093), (0.0385, 0.09), (0.038, 0.012), (0.034, 0.008), (0, 0.008)],
            m.CERAMIC, tint, 40)  # fmt: skip
    bend = np.linspace(-1.25, 1.25, 15)
    tube(build, [(0.036 + 0.026 * np.cos(a), 0, 0.048 + 0.029 * np.sin(a)) for a in bend], 0.0048, m.CERAMIC, tint)


def fruit(build: Builder, radius: float, tint: Color) -> None:
    """A round fruit in a bowl."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 13)
    dimple = 1 - 0.12 * np.exp(-(((angle - np.pi / 2) / 0.25) ** 2))
    revolve(build, [(radius * np.cos(a), radius * (1 + np.sin(a) * d)) for a, d in zip(angle, dimple)],
            m.LACQUER, tint, 24)  # fmt: skip


def framed_picture(build: Builder, width: float, height: float, tint: Color, shift: float = 0.0) -> None:
    """A picture under glass, its back on the local plane y = 0, centred on the origin."""
    half, tall, bar, mat = width / 2, height / 2, 0.022, 0.06
    for low, high in (
        ((-half, -0.025, -tall), (half, 0, bar - tall)),
        ((-half, -0.025, tall - bar), (half, 0, tall)),
        ((-half, -0.025, bar - tall), (bar - half, 0, tall - bar)),
        ((half - bar, -0.025, bar - tall), (half, 0, tall - bar)),
    ):
        box(build, low, high, m.WOOD, tint, bevel=0.002, texel=0.02)
    a, b = half - bar, tall - bar
    panel(build, (-a, -0.008, -b), (2 * a, 0, 0), (0, 0, 2 * b), m.CERAMIC, (0.80, 0.79, 0.75), texel=0.03)
    a, b = a - mat, b - mat
    panel(build, (-a, -0.0095, -b), (2 * a, 0, 0), (0, 0, 2 * b), m.PICTURE, texel=0.03, stretch=shift)


def storage_box(build: Builder, wide: float, deep: float, tall: float, tint: Color) -> None:
    """A cardboard box with a lid."""
    box(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall * 0.72), m.WEAVE, tint)
    box(build, (-wide / 2 - 0.004, -deep / 2 - 0.004, tall * 0.72), (wide / 2 + 0.004, deep / 2 + 0.004, tall),
        m.WEAVE, tint)  # fmt: skip


def basket(build: Builder, radius: float, tall: float) -> None:
    """A woven basket, open at the top."""
    outer = [(0.82 * radius, 0.0), (0.9 * radius, 0.1 * tall), (radius, 0.55 * tall), (0.95 * radius, tall)]
    inner = [(r - 0.012, max(z, 0.012)) for r, z in outer[::-1]]
    revolve(build, [(0, 0), *outer, (0.95 * radius - 0.006, tall + 0.004), *inner, (0, 0.012)], m.STRIPES,
            (0.62, 0.44, 0.26), 48, 0.015, 3)  # fmt: skip


def plant(build: Builder, leaves: int, tall: float, pot: float, spread: float, tint: Color) -> None:
    """A pot with arching stems, each ending in a broad leaf, within `spread` of its axis."""
    revolve(build, [(0, 0), (0.72 * pot, 0), (0.74 * pot, 0.004), (pot, 1.7 * pot), (pot, 1.75 * pot),
                    (0.92 * pot, 1.75 * pot), (0.90 * pot, 1.6 * pot)], m.CERAMIC, tint, 40, 0.015)  # fmt: skip
    revolve(build, [(0.91 * pot, 1.6 * pot), (0.5 * pot, 1.63 * pot), (0, 1.62 * pot)], m.SOIL, WHITE, 24, 0.02)
    for k in range(leaves):
        share = (k + 0.5) / leaves
        height = tall * (0.45 + 0.55 * share) * build.rng.uniform(0.92, 1.05)
        length = tall * build.rng.uniform(0.13, 0.19)
        reach = (spread - 0.02 - length) * (1.0 - 0.5 * share) * build.rng.uniform(0.75, 1.0)
        with build.placed(0, 0, 1.6 * pot, 137.5 * k + build.rng.uniform(-15, 15)):
            _stem_and_leaf(build, reach, height - 1.6 * pot, length)


def _stem_and_leaf(build: Builder, reach: float, rise: float, length: float) -> None:
    at = np.linspace(0, 1, 8)
    path = np.stack([0.02 + reach * at**1.8, 0 * at, rise * np.sin(at * np.pi / 2)], -1)
    tube(build, path, 0.004 - 0.002 * at, m.LEAF, (1.0, 1.1, 0.8), 6, caps=False)
    t, s = np.meshgrid(np.linspace(0, 1, 11), np.linspace(-1, 1, 7), indexing="ij")
    wide = 0.40 * length * np.sin(np.pi * np.clip(t, 0.015, 0.985)) ** 0.75 * (1.15 - 0.5 * t)
    droop = build.rng.uniform(0.5, 1.0)
    x = path[-1, 0] + length * (t - 0.10 * droop * t**2)
    z = path[-1, 2] + length * (0.25 * t - droop * 0.65 * t**2) + 0.25 * wide * np.abs(s)
    grid = np.stack([x, wide * s, z], -1)
    shade = build.rng.uniform(0.75, 1.2)
    sheet(build, grid[:, ::-1], m.LEAF, (shade, shade, shade * 0.95), 0.0012, 0.025)
