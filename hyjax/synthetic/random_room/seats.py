"""Seats and beds of random sizes: each a `Furnishing`."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.parts import add_legs
from hyjax.synthetic.random_room.plan import Furnishing, Top
from hyjax.synthetic.room import furniture as made
from hyjax.synthetic.shapes import box, cushion, pillow, revolve, sheet, tube


def chair(rng: np.random.Generator) -> Furnishing:
    """A chair with spindles, slats or a panel as its back; a stool without one."""
    style, wide, tall = int(rng.integers(4)), rng.uniform(0.38, 0.5), rng.uniform(0.42, 0.5)

    def add(build: RoomBuilder) -> list[Top]:
        look = build.draw(str(build.rng.choice(["wood", "wood", "lacquer", "plastic"])))
        if style == 0:
            with build.scaled(wide / 0.43, wide / 0.46, tall / 0.46), build.dressed():
                made.add_chair(build, made.BEECH)
            return []
        half, seat = wide / 2, look if build.rng.random() < 0.5 else build.draw("cloth")
        cushion(build, (-half, -half, tall - 0.04), (half, half, tall), 0.015, seat, flat_steps=2)
        add_legs(build, half - 0.03, half - 0.03, tall - 0.03, look)
        if style == 1:
            return [Top((-half, -half), (half, half), tall, 0.4)]
        back = build.rng.uniform(0.3, 0.55)
        with build.placed(0, half - 0.03, tall), build.tilted(-build.rng.uniform(2, 12)):
            for x in (-half + 0.02, half - 0.02):
                tube(build, [(x, 0, -0.03), (x, 0, back)], 0.015, look)
            if style == 2:
                for z in np.linspace(0.25, 0.92, int(build.rng.integers(2, 5))) * back:
                    box(build, (0.02 - half, -0.01, z - 0.03), (half - 0.02, 0.01, z + 0.03), look)
            else:
                box(build, (0.02 - half, -0.012, 0.12 * back), (half - 0.02, 0.012, back), seat, bevel=0.008)
        return [Top((-0.8 * half, -0.8 * half), (0.8 * half, 0.5 * half), tall, 0.3)] * (build.rng.random() < 0.3)

    return Furnishing(1.15 * wide, 1.25 * wide, tall + 0.5, add)


def office_chair(rng: np.random.Generator) -> Furnishing:
    """A chair on five castors, with or without arms."""
    wide, tall, arms = rng.uniform(0.44, 0.54), rng.uniform(0.42, 0.55), rng.random() < 0.5

    def add(build: RoomBuilder) -> list[Top]:
        half, frame, cloth = wide / 2, build.draw("plastic"), build.draw("cloth")
        start = build.rng.uniform(0, 72)
        for k in range(5):
            with build.placed(0, 0, 0, start + 72 * k):
                tube(build, [(0, 0, 0.12), (0.3, 0, 0.08)], [0.026, 0.017], frame, sides=8)
                with build.placed(0.29, -0.012, 0.03), build.tilted(-90):
                    revolve(build, [(0, 0), (0.03, 0), (0.03, 0.024), (0, 0.024)], frame, sides=14)
        tube(build, [(0, 0, 0.1), (0, 0, tall - 0.06)], 0.025, build.draw("metal"), sides=12)
        cushion(build, (-half, -half, tall - 0.07), (half, half, tall), 0.03, cloth, bulge=0.02)
        with build.placed(0, half - 0.02, tall + 0.06), build.tilted(-build.rng.uniform(2, 15)):
            box(build, (-0.03, 0.03, -0.12), (0.03, 0.045, 0.3), frame)
            cushion(
                build, (0.03 - half, -0.03, 0.05), (half - 0.03, 0.03, build.rng.uniform(0.35, 0.6)), 0.028, cloth
            )
        for side in (-half, half) if arms else ():
            line = [(side, 0.1, tall - 0.04), (1.12 * side, 0.1, tall + 0.05), (1.12 * side, 0.08, tall + 0.2)]
            tube(build, line, 0.014, frame, sides=8)
            box(build, (1.12 * side - 0.03, -0.15, tall + 0.2), (1.12 * side + 0.03, 0.14, tall + 0.225), frame)
        return []

    return Furnishing(max(0.66, 1.25 * wide), 0.8, tall + 0.7, add)


def sofa(rng: np.random.Generator) -> Furnishing:
    """A sofa or an armchair with loose cushions."""
    if rng.random() < 0.4:
        scale = rng.uniform(0.8, 1.15)

        def add_made(build: RoomBuilder) -> list[Top]:
            with build.scaled(scale, scale, scale), build.dressed():
                made.add_sofa(build)
            return [Top((-0.8 * scale, -0.4 * scale), (0.8 * scale, 0.0), 0.45 * scale, 0.3)] * (
                build.rng.random() < 0.4
            )

        return Furnishing(2.1 * scale, 0.95 * scale, 0.85 * scale, add_made, wall=True)
    seats = int(rng.integers(1, 4))
    wide, deep, seat = 0.25 + 0.62 * seats, rng.uniform(0.75, 0.95), rng.uniform(0.38, 0.46)
    back, arm = rng.uniform(0.7, 0.95), rng.uniform(0.08, 0.2)

    def add(build: RoomBuilder) -> list[Top]:
        cloth = build.draw("cloth")
        inner = wide / 2 - arm
        add_legs(build, wide / 2 - 0.08, deep / 2 - 0.08, 0.08, build.draw("wood"))
        cushion(build, (-wide / 2, 0.02 - deep / 2, 0.06), (wide / 2, deep / 2, 0.26), 0.03, cloth, flat_steps=2)
        for side in (-1, 1):
            low, high = sorted((side * inner, side * wide / 2))
            cushion(
                build, (low, 0.02 - deep / 2, 0.06), (high, deep / 2, seat + 0.2), 0.35 * arm, cloth, flat_steps=2
            )
        cushion(build, (-inner, deep / 2 - 0.22, 0.2), (inner, deep / 2, back), 0.07, cloth, flat_steps=2)
        step = 2 * inner / seats
        for k in range(seats):
            x = -inner + k * step
            cushion(
                build,
                (x + 0.004, -deep / 2, 0.25),
                (x + step - 0.004, deep / 2 - 0.2, seat),
                0.05,
                cloth,
                bulge=0.12,
            )
            if build.rng.random() < 0.6:
                size = build.rng.uniform(0.3, 0.45)
                with build.placed(x + step / 2, deep / 2 - 0.36, seat, build.rng.uniform(-20, 20)):
                    lean = build.rng.uniform(15, 30)
                    pillow(build, size, 0.14, lean, build.draw("cloth"), (1, 1, 1), size / 2 - 0.02)
        if build.rng.random() < 0.3:
            _throw(build, -inner, inner, deep / 2 - 0.25, back)
        return []

    return Furnishing(wide, deep, back + 0.05, add, wall=True)


def _throw(build: RoomBuilder, low: float, high: float, y: float, top: float) -> None:
    """A blanket over the backrest."""
    t, s = np.meshgrid(np.linspace(0, 1, 16), np.linspace(0, 1, 14), indexing="ij")
    x = low + (high - low) * (0.1 + 0.5 * build.rng.random()) + 0.4 * s
    ripple = 0.008 * np.sin(14 * s + 3 * t)
    bend = np.clip(t * 2, 0, 1)
    grid = np.stack(
        [x, y - 0.035 + ripple + 0.15 * (1 - bend), top + 0.02 + ripple - 0.45 * np.clip(t - 0.5, 0, 1)], -1
    )
    sheet(build, grid[:, ::-1], build.draw("cloth"), thickness=0.004)


def bed(rng: np.random.Generator) -> Furnishing:
    """A bed with a blanket and pillows, its head at the wall."""
    wide, deep, tall = rng.uniform(0.8, 1.9), rng.uniform(1.9, 2.15), rng.uniform(0.35, 0.55)

    def add(build: RoomBuilder) -> list[Top]:
        frame, x, y = build.draw("wood"), wide / 2, deep / 2
        box(build, (-x, -y, 0.08), (x, y, 0.6 * tall), frame)
        box(build, (-x, y - 0.05, 0), (x, y, tall + build.rng.uniform(0.2, 0.6)), frame)
        cushion(build, (0.02 - x, 0.02 - y, 0.55 * tall), (x - 0.02, y - 0.06, tall), 0.05, build.draw("cloth"))
        t, s = np.meshgrid(np.linspace(0, 1, 24), np.linspace(-1, 1, 24), indexing="ij")
        a = build.rng.uniform(3, 9, 4)
        z = tall + 0.015 + 0.02 * (np.sin(a[0] * s + a[1] * t) * np.sin(a[2] * t - a[3] * s) + 1)
        fall = np.clip(np.abs(s) - 0.93, 0, 1) / 0.07
        grid = np.stack([s * (x + 0.01), t * 0.68 * deep - y - 0.01, z - 0.18 * fall], -1)
        sheet(build, grid, build.draw("cloth"), thickness=0.02)
        for k in range(1 + (wide > 1.2)):
            px = 0.0 if wide <= 1.2 else (k - 0.5) * 0.8
            cushion(build, (px - 0.33, y - 0.5, tall), (px + 0.33, y - 0.1, tall + 0.1), 0.049, build.draw("cloth"),
                    bulge=0.06)  # fmt: skip
        return [Top((-0.7 * x, -0.8 * y), (0.7 * x, 0.1 * y), tall + 0.055, 0.4)] * (build.rng.random() < 0.5)

    return Furnishing(wide + 0.1, deep + 0.03, tall + 0.6, add, wall=True)
