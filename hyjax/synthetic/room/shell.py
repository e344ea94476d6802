"""Shell of the room: walls with a window and a door, floor, ceiling, skirting, radiator and curtains.

x runs from the window wall to the sofa wall, y from the door wall to the shelf wall, z up; metres.
"""

import numpy as np

from hyjax.synthetic.room import materials as m
from hyjax.synthetic.shapes import box, panel, revolve, sheet, tube
from hyjax.synthetic.surface import Builder, Color

WIDTH, DEPTH, HEIGHT = 4.4, 5.2, 2.6
WALL_THICKNESS = 0.24
OVERLAP = 0.006
"""Overlap of the shell's rectangles in metres, so that no ray slips out where they meet."""
WINDOW = (1.75, 4.15, 0.82, 2.22)
"""Window: y from, y to, z from, z to, in metres."""
DOOR = (3.12, 3.98, 2.04)
"""Door: x from, x to, height, in metres."""

WARM_WHITE: Color = (0.80, 0.775, 0.73)
CEILING: Color = (0.86, 0.855, 0.84)
TRIM: Color = (0.80, 0.79, 0.76)
BRASS: Color = (0.55, 0.38, 0.16)
STEEL: Color = (0.10, 0.10, 0.105)
ACCENTS: tuple[Color, ...] = ((0.30, 0.385, 0.37), (0.29, 0.36, 0.42), (0.42, 0.40, 0.33))


def add_shell(build: Builder) -> None:
    """Add walls, floor and ceiling with everything fixed to them."""
    accent = ACCENTS[build.rng.integers(len(ACCENTS))]
    y0, y1, z0, z1 = WINDOW
    x0, x1, top = DOOR
    w, d, h = WIDTH, DEPTH, HEIGHT
    e = OVERLAP
    w2, d2, h2 = w + 2 * e, d + 2 * e, h + 2 * e
    panel(build, (-e, -e, 0), (w2, 0, 0), (0, d2, 0), m.FLOOR, texel=0.026)
    panel(build, (-e, -e, h), (0, d2, 0), (w2, 0, 0), m.PAINT, CEILING, texel=0.07)
    hole = (y0 + e, z0 + e, y1 + e, z1 + e)
    panel(build, (0, -e, -e), (0, d2, 0), (0, 0, h2), m.PAINT, WARM_WHITE, [hole])
    panel(build, (w, d + e, -e), (0, -d2, 0), (0, 0, h2), m.PAINT, accent)
    doorway = (w + e - x1, 0, w + e - x0, top + e)
    panel(build, (w + e, 0, -e), (-w2, 0, 0), (0, 0, h2), m.PAINT, WARM_WHITE, [doorway])
    panel(build, (-e, d, -e), (w2, 0, 0), (0, 0, h2), m.PAINT, WARM_WHITE)
    _skirting(build)
    _window(build)
    _door(build)
    _radiator(build)
    _curtains(build)


def _skirting(build: Builder) -> None:
    w, d, high, deep = WIDTH, DEPTH, 0.09, 0.016
    x0, x1, _ = DOOR
    for low, top in (
        ((0, 0, 0), (deep, d, high)),
        ((w - deep, 0, 0), (w, d, high)),
        ((deep, d - deep, 0), (w - deep, d, high)),
        ((deep, 0, 0), (x0 - 0.07, deep, high)),
        ((x1 + 0.07, 0, 0), (w - deep, deep, high)),
    ):
        box(build, low, top, m.LACQUER, TRIM, bevel=0.004)


def _window(build: Builder) -> None:
    y0, y1, z0, z1 = WINDOW
    # The reveal stands a hair back from the wall's edge: the wall covers the joint.
    y0, y1, z0, z1 = y0 - 0.001, y1 + 0.001, z0 - 0.001, z1 + 0.001
    dy, dz, t = y1 - y0, z1 - z0, WALL_THICKNESS
    for origin, s, u in (
        ((-t, y0, z0), (t, 0, 0), (0, dy, 0)),
        ((-t, y0, z1), (0, dy, 0), (t, 0, 0)),
        ((-t, y0, z0), (0, 0, dz), (t, 0, 0)),
        ((-t, y1, z0), (t, 0, 0), (0, 0, dz)),
    ):
        panel(build, origin, s, u, m.PAINT, WARM_WHITE, texel=0.03)
    near, far, bar = -0.10, -0.17, 0.055
    for low, high in (
        ((far, y0, z0), (near, y1, z0 + bar)),
        ((far, y0, z1 - bar), (near, y1, z1)),
        ((far, y0, z0 + bar), (near, y0 + bar, z1 - bar)),
        ((far, y1 - bar, z0 + bar), (near, y1, z1 - bar)),
    ):
        box(build, low, high, m.LACQUER, TRIM, bevel=0.005)
    for k in (1, 2):
        y = y0 + dy * k / 3
        box(build, (far + 0.01, y - 0.04, z0 + bar), (near + 0.012, y + 0.04, z1 - bar), m.LACQUER, TRIM, 0.006)
    transom = z0 + 0.70 * dz
    for k in range(3):
        a, b = y0 + dy * k / 3 + 0.04, y0 + dy * (k + 1) / 3 - 0.04
        low, high = (far + 0.02, a, transom - 0.018), (near - 0.01, b, transom + 0.018)
        box(build, low, high, m.LACQUER, TRIM, 0.005)
        with build.placed(near, a + 0.02 if k != 1 else b - 0.02, z0 + 0.36 * dz):
            tube(build, [(0, 0, 0), (0.035, 0, 0)], 0.008, m.CERAMIC, BRASS)
            box(build, (0.03, -0.008, -0.06), (0.042, 0.008, 0.012), m.CERAMIC, BRASS)
    box(build, (-0.11, y0 - 0.04, z0 - 0.03), (0.045, y1 + 0.04, z0 + 0.004), m.LACQUER, TRIM, bevel=0.006)
    build.anchors["window_0"] = {
        "center": build.world((0.0, (y0 + y1) / 2, (z0 + z1) / 2)),
        "right": [0.0, dy / 2, 0.0],
        "up": [0.0, 0.0, dz / 2],
        "normal": [1.0, 0.0, 0.0],
        "width": dy,
        "height": dz,
    }


def _door(build: Builder) -> None:
    x0, x1, top = DOOR
    deep, wide = 0.07, 0.07
    panel(build, (x0, -deep, 0.001), (x1 - x0, 0, 0), (0, deep + 0.01, 0), m.WOOD, (0.5, 0.4, 0.3), texel=0.03)
    panel(build, (x1, -deep, 0), (0, 0, top), (0, deep, 0), m.LACQUER, TRIM, texel=0.03)
    panel(build, (x0, -deep, 0), (0, deep, 0), (0, 0, top), m.LACQUER, TRIM, texel=0.03)
    panel(build, (x0, -deep, top), (0, deep, 0), (x1 - x0, 0, 0), m.LACQUER, TRIM, texel=0.03)
    for low, high in (
        ((x0 - wide, 0, 0), (x0, 0.02, top + wide)),
        ((x1, 0, 0), (x1 + wide, 0.02, top + wide)),
        ((x0, 0, top), (x1, 0.02, top + wide)),
    ):
        box(build, low, high, m.LACQUER, TRIM, bevel=0.005)
    panel(build, (x1, -0.058, 0), (x0 - x1, 0, 0), (0, 0, top), m.LACQUER, TRIM)
    stile, rails = 0.115, ((0.01, 0.22), (0.93, 1.08), (top - 0.13, top))
    for a, b in ((x0 + 0.003, x0 + stile), (x1 - stile, x1 - 0.003)):
        box(build, (a, -0.065, 0.01), (b, -0.035, top - 0.003), m.LACQUER, TRIM, bevel=0.006)
    for a, b in rails:
        box(build, (x0 + stile, -0.065, a), (x1 - stile, -0.035, b - 0.003), m.LACQUER, TRIM, bevel=0.006)
    with build.placed(x0 + 0.06, -0.035, 1.0):
        box(build, (-0.02, -0.005, -0.1), (0.02, 0.008, 0.06), m.CERAMIC, BRASS, bevel=0.003)
        tube(build, [(0, 0, 0), (0, 0.045, 0), (0.004, 0.052, 0), (0.12, 0.052, 0)], 0.009, m.CERAMIC, BRASS)


def _radiator(build: Builder) -> None:
    y0, y1 = WINDOW[0] + 0.55, WINDOW[1] - 0.55
    columns = 22
    for k in range(columns):
        y = y0 + (y1 - y0) * k / columns
        box(build, (0.04, y, 0.14), (0.12, y + 0.042, 0.68), m.LACQUER, TRIM, bevel=0.012, texel=0.06)
    for z in (0.18, 0.62):
        box(build, (0.06, y0, z), (0.10, y1 - 0.01, z + 0.05), m.LACQUER, TRIM)
    for y in (y0 + 0.1, y1 - 0.1):
        box(build, (0.0, y, 0.2), (0.06, y + 0.03, 0.24), m.LACQUER, TRIM)
    tube(build, [(0.08, y1, 0.2), (0.08, y1 + 0.07, 0.2)], 0.012, m.LACQUER, TRIM)
    tube(build, [(0.08, y1 + 0.07, 0.0), (0.08, y1 + 0.07, 0.24)], 0.009, m.LACQUER, TRIM)


def _curtains(build: Builder) -> None:
    y0, y1 = WINDOW[:2]
    rod = HEIGHT - 0.16
    tube(build, [(0.10, y0 - 0.50, rod), (0.10, y1 + 0.50, rod)], 0.012, m.LACQUER, STEEL)
    for y in (y0 - 0.5, y1 + 0.5):
        with build.placed(0.10, y, rod):
            angle = np.linspace(-np.pi / 2, np.pi / 2, 9)
            revolve(build, [(0.024 * np.cos(a), 0.024 * np.sin(a)) for a in angle], m.LACQUER, STEEL, 16)
    for y in (y0 - 0.42, y1 + 0.42):
        box(build, (0.0, y - 0.01, rod - 0.008), (0.10, y + 0.01, rod + 0.008), m.LACQUER, STEEL)
    for left in (y0 - 0.44, y1 - 0.04):
        phase, folds = build.rng.uniform(0, 6), 5
        s, t = np.meshgrid(np.linspace(0, 1, 81), np.linspace(0, 1, 15))
        wave = 2 * np.pi * folds * s + phase + 0.5 * np.sin(3 * t + phase)
        deep = (0.020 + 0.018 * (1 - t)) * (1 + 0.35 * np.sin(2.3 * s * folds + phase))
        grid = np.stack(
            [0.10 + deep * np.sin(wave), left + 0.48 * s + 0.012 * np.cos(wave), 0.02 + t * (rod - 0.034)], -1
        )
        sheet(build, grid, m.WEAVE, (0.72, 0.68, 0.60), thickness=0.002, texel=0.035)
