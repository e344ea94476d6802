"""Common parts of furniture."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.shapes import box, tube


def add_legs(build: RoomBuilder, x: float, y: float, tall: float, look: int) -> None:
    """Add four legs with their centres at (±x, ±y): square, round, tapered or splayed."""
    thick, round_ = build.rng.uniform(0.012, 0.045), build.rng.random() < 0.5
    splay = 1 + build.rng.choice([0.0, min(0.04, 0.1 * tall / max(x, y))])
    for sx in (-x, x):
        for sy in (-y, y):
            if round_:
                tube(build, [(sx * splay, sy * splay, 0), (sx, sy, tall)], [0.6 * thick, thick], look)
            else:
                box(build, (sx - thick, sy - thick, 0), (sx + thick, sy + thick, tall), look)


def add_fronts(build: RoomBuilder, x0: float, x1: float, z0: float, z1: float, y: float, look: int) -> None:
    """Add doors or drawers with gaps and handles on the plane `y`, facing -y."""
    drawers = build.rng.random() < 0.4
    across = max(1, round((x1 - x0) / build.rng.uniform(0.35, 0.8)))
    down = int(build.rng.integers(2, 5)) if drawers else 1
    metal, style = build.draw("metal"), int(build.rng.integers(3))
    dx, dz, gap = (x1 - x0) / across, (z1 - z0) / down, 0.003
    for i in range(across):
        for j in range(down):
            low = (x0 + i * dx + gap, y - 0.018, z0 + j * dz + gap)
            high = (x0 + (i + 1) * dx - gap, y, z0 + (j + 1) * dz - gap)
            box(build, low, high, look, bevel=0.002, grain="x" if drawers else "z")
            if style == 0:
                continue
            x = (low[0] + high[0]) / 2 if drawers else (high[0] - 0.05 if i % 2 == 0 else low[0] + 0.05)
            with build.placed(x, y - 0.018, (low[2] + high[2]) / 2):
                if style == 1:
                    tube(build, [(0, 0, 0), (0, -0.025, 0)], [0.008, 0.014], metal)
                else:
                    across_ = (1, 0, 0) if drawers else (0, 0, 1)
                    bar, out = np.array([[-0.07], [0.07]]) * across_, np.array([0, -0.03, 0])
                    tube(build, bar + out, 0.006, metal)
                    for end in bar:
                        tube(build, [end, end + out], 0.005, metal, sides=6)
