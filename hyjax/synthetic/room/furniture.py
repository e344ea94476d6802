"""Furniture: each piece in its own axes, standing on z = 0 with its front towards -y."""

import numpy as np

from hyjax.synthetic.room import materials as m
from hyjax.synthetic.room.shell import BRASS, STEEL
from hyjax.synthetic.shapes import box, cushion, panel, pillow, revolve, tube
from hyjax.synthetic.surface import Builder, Color

OAK: Color = (0.50, 0.40, 0.31)
WALNUT: Color = (0.27, 0.17, 0.11)
BEECH: Color = (0.58, 0.47, 0.36)
LINEN: Color = (0.80, 0.75, 0.66)
SOFA_COLORS: tuple[Color, ...] = ((0.27, 0.28, 0.29), (0.40, 0.36, 0.31), (0.15, 0.20, 0.26))


def add_sofa(build: Builder) -> None:
    """A two-seat sofa, 2.04 m wide and 0.9 m deep, with loose cushions."""
    cloth = SOFA_COLORS[build.rng.integers(len(SOFA_COLORS))]
    for x in (-0.9, 0.9):
        for y in (-0.36, 0.36):
            with build.placed(x, y):
                tube(build, [(0, 0, 0), (0, 0, 0.13)], [0.016, 0.024], m.WOOD, WALNUT)
    cushion(build, (-0.9, -0.42, 0.12), (0.9, 0.40, 0.30), 0.03, m.FABRIC, cloth)
    for side in (-1, 1):
        low, high = sorted((side * 0.83, side * 1.02))
        cushion(build, (low, -0.44, 0.12), (high, 0.44, 0.60), 0.07, m.FABRIC, cloth)
    cushion(build, (-0.86, 0.24, 0.20), (0.86, 0.45, 0.80), 0.08, m.FABRIC, cloth)
    for low, high in ((-0.825, -0.004), (0.004, 0.825)):
        cushion(build, (low, -0.45, 0.295), (high, 0.24, 0.435), 0.05, m.FABRIC, cloth, 0.16)
        cushion(build, (low + 0.01, 0.10, 0.435), (high - 0.01, 0.28, 0.84), 0.075, m.FABRIC, cloth, 0.16, 1)
    mustard, teal = (0.55, 0.33, 0.07), (0.11, 0.20, 0.205)
    for x, turn, lean, size, material, tint in (
        (-0.60, -14, 22, 0.46, m.STRIPES, (1.0, 1.0, 1.0)),
        (-0.33, 10, 30, 0.40, m.WEAVE, mustard),
        (0.58, 12, 24, 0.46, m.WEAVE, teal),
    ):
        with build.placed(x, -0.02 - 0.09 * (size < 0.45), 0.445, turn + build.rng.uniform(-5, 5)):
            pillow(build, size, 0.16, lean, material, tint, size / 2 - 0.02)


def add_table(build: Builder) -> None:
    """A dining table, 1.4 × 0.85 m, top at 0.75 m."""
    box(build, (-0.70, -0.425, 0.722), (0.70, 0.425, 0.75), m.WOOD, OAK, bevel=0.006, texel=0.02)
    for side in (-1, 1):
        low, high = sorted((side * 0.355, side * 0.38))
        box(build, (-0.6, low, 0.64), (0.6, high, 0.722), m.WOOD, OAK)
        low, high = sorted((side * 0.61, side * 0.635))
        box(build, (low, -0.36, 0.64), (high, 0.36, 0.722), m.WOOD, OAK)
        for y in (-0.36, 0.36):
            tube(build, [(side * 0.63, y * 1.03, 0), (side * 0.62, y, 0.722)], [0.019, 0.032], m.WOOD, OAK, 16)


def add_chair(build: Builder, tint: Color) -> None:
    """A spindle-backed chair."""
    cushion(build, (-0.215, -0.21, 0.432), (0.215, 0.21, 0.462), 0.0149, m.WOOD, tint, texel=0.02)
    for x in (-0.18, 0.18):
        tube(build, [(x * 1.12, -0.19, 0), (x, -0.16, 0.44)], [0.012, 0.018], m.WOOD, tint)
        tube(build, [(x * 1.12, 0.23, 0), (x, 0.175, 0.44)], [0.012, 0.018], m.WOOD, tint)
        tube(build, [(x, 0.175, 0.45), (x * 1.04, 0.235, 0.83)], [0.015, 0.011], m.WOOD, tint)
        tube(build, [(x * 1.07, -0.178, 0.2), (x * 1.07, 0.207, 0.2)], 0.009, m.WOOD, tint, 8)
    for x in (-0.10, -0.033, 0.033, 0.10):
        tube(build, [(x, 0.18, 0.455), (x * 1.04, 0.238, 0.80)], 0.0065, m.WOOD, tint, 8)
    bend = np.linspace(-1, 1, 9)
    rail = [(0.205 * b, 0.237 + 0.018 * (1 - b * b), 0.83) for b in bend]
    tube(build, rail, 0.022 * (1 - 0.3 * bend**2), m.WOOD, tint, 12)


def add_coffee_table(build: Builder) -> None:
    """A round low table, 0.8 m across, top at 0.41 m."""
    with build.placed(0, 0, 0.38):
        profile = [(0, 0), (0.385, 0), (0.387, 0.001), (0.40, 0.012), (0.40, 0.024), (0.396, 0.029),
                   (0.392, 0.030), (0.39, 0.030), (0, 0.030)]  # fmt: skip
        revolve(build, profile, m.WOOD, WALNUT, 64, 0.025, 1, "above")
    for k in range(3):
        with build.placed(0, 0, 0, 120 * k + 20):
            tube(build, [(0.33, 0, 0), (0.24, 0, 0.38)], [0.012, 0.02], m.WOOD, WALNUT, 12)


def add_bookcase(build: Builder, width: float, height: float, shelves: int) -> list[float]:
    """An open bookcase, 0.3 m deep, back at y = 0. Returns the heights things stand on, from below."""
    board, deep, half = 0.022, 0.30, width / 2
    for side in (-1, 1):
        low, high = sorted((side * half, side * (half - board)))
        box(build, (low, -deep, 0), (high, 0, height), m.WOOD, BEECH, texel=0.04)
    panel(build, (-half, -0.006, 0.03), (width, 0, 0), (0, 0, height - 0.03), m.WOOD, BEECH, texel=0.04)
    step = (height - 0.06 - board) / shelves
    tops = []
    for k in range(shelves + 1):
        z = 0.06 + step * k
        box(build, (board - half, -deep + 0.004, z), (half - board, -0.006, z + board), m.WOOD, BEECH, texel=0.04)
        tops.append(z + board)
    box(build, (board - half, -deep + 0.03, 0), (half - board, -deep + 0.05, 0.06), m.WOOD, BEECH)
    return tops[:-1]


def add_sideboard(build: Builder) -> None:
    """A cabinet with three doors, 1.6 × 0.4 m, top at 0.78 m, back at y = 0."""
    half, deep = 0.8, 0.40
    box(build, (-half, -deep, 0.15), (half, 0, 0.78), m.WOOD, WALNUT, bevel=0.004)
    for k in range(3):
        low, high = -half + 0.025 + k * 0.519, -half + 0.025 + k * 0.519 + 0.512
        box(build, (low, -deep - 0.018, 0.175), (high, -deep, 0.755), m.LACQUER, (0.62, 0.60, 0.55), bevel=0.003)
        with build.placed(high - 0.05, -deep - 0.018, 0.60):
            tube(build, [(0, 0, 0), (0, -0.022, 0)], [0.007, 0.013], m.CERAMIC, BRASS, 16)
    for x in (-0.7, 0.7):
        for y in (-0.35, -0.05):
            tube(build, [(x * 1.03, y, 0), (x, y, 0.155)], [0.013, 0.022], m.WOOD, WALNUT)


def add_floor_lamp(build: Builder, name: str) -> None:
    """A standing lamp with a linen shade, 1.55 m high."""
    revolve(build, [(0, 0), (0.145, 0), (0.15, 0.004), (0.15, 0.018), (0.145, 0.023), (0.02, 0.03), (0, 0.03)],
            m.LACQUER, STEEL, 48)  # fmt: skip
    tube(build, [(0, 0, 0.03), (0, 0, 1.34)], 0.011, m.LACQUER, STEEL, 16)
    _shade(build, 1.22, 0.21, 0.15, 0.32, m.WEAVE, LINEN)
    _bulb(build, name, 1.38)


def add_pendant(build: Builder, name: str, ceiling: float) -> None:
    """A lamp hanging over a table, its shade's rim at 1.6 m."""
    tube(build, [(0, 0, 1.84), (0, 0, ceiling)], 0.004, m.LACQUER, STEEL, 8)
    revolve(build, [(0, ceiling - 0.03), (0.045, ceiling - 0.03), (0.055, ceiling - 0.02), (0.055, ceiling)],
            m.LACQUER, STEEL, 32)  # fmt: skip
    wall = [(0.20, 1.64), (0.196, 1.70), (0.175, 1.76), (0.13, 1.81), (0.06, 1.84), (0.03, 1.86), (0, 1.862)]
    inner = [(max(r - 0.004, 0), z - 0.004) for r, z in wall[::-1]]
    revolve(build, [*inner, (0.197, 1.637), *wall], m.LACQUER, (0.13, 0.17, 0.16), 48, 0.015, 2)
    _bulb(build, name, 1.74)


def _shade(build: Builder, z: float, low: float, high: float, tall: float, material: int, tint: Color) -> None:
    outer = [(low, z), (high, z + tall)]
    inner = [(high - 0.004, z + tall), (low - 0.004, z)]
    revolve(build, [*inner, (low - 0.002, z - 0.001), *outer, (high - 0.002, z + tall + 0.001), inner[0]],
            material, tint, 48, 0.02, 3)  # fmt: skip
    for turn in (0, 120, 240):
        with build.placed(0, 0, 0, turn):
            tube(build, [(0.0, 0, z + 0.12), (0.30 * low + 0.70 * high - 0.012, 0, z + 0.12)], 0.0025, m.LACQUER,
                 STEEL, 6)  # fmt: skip


def _bulb(build: Builder, name: str, z: float) -> None:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 13)
    profile = [(0.032 * np.cos(a), z + 0.036 * np.sin(a)) for a in angle]
    revolve(build, profile, m.CERAMIC, (0.85, 0.84, 0.80), 24)
    build.anchors[name] = {"position": build.world((0, 0, z))}
