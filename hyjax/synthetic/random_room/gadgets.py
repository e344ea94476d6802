"""Tools and devices that lie about: each a `Furnishing`."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.plan import Furnishing, Top
from hyjax.synthetic.shapes import box, cushion, panel, tube


def cable(rng: np.random.Generator) -> Furnishing:
    """A curled cord."""
    wide, deep, radius = (
        float(rng.uniform(0.15, 0.6)),
        float(rng.uniform(0.1, 0.4)),
        float(rng.uniform(0.002, 0.006)),
    )

    def add(build: RoomBuilder) -> list[Top]:
        at = np.linspace(0, 1, 60)
        bends = build.rng.normal(size=(2, 4)) / np.arange(1, 5)
        phase = build.rng.uniform(0, 6, (2, 4))
        x, y = (sum(b[k] * np.sin(np.pi * (k + 1) * at * 2 + p[k]) for k in range(4)) for b, p in zip(bends, phase))
        x, y = (0.46 * side * a / np.abs(a).max() for a, side in ((x, wide), (y, deep)))
        # Where it crosses itself, the later strand is the higher one.
        line = np.stack([x, y, radius + 2 * radius * at], -1)
        tube(build, line, radius, build.draw("plastic"), sides=7)
        return []

    return Furnishing(wide, deep, 4 * radius, add)


def tool(rng: np.random.Generator) -> Furnishing:
    """A lying tool: handle, shaft and perhaps a head; a pen or a brush when small."""
    length, thick = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.006, 0.02))
    head = float(rng.choice([0.0, rng.uniform(0.02, 0.06)]))

    def add(build: RoomBuilder) -> list[Top]:
        grip, half = build.rng.uniform(0.3, 0.9) * length, length / 2
        at = np.linspace(0, 1, 7)
        swell = thick * (0.75 + 0.25 * np.sin(at * build.rng.uniform(3, 9)))
        with build.placed(0, 0, thick):
            line = [(a * grip - half, 0, 0) for a in at]
            tube(build, line, swell, build.draw(str(build.rng.choice(["plastic", "wood"]))), sides=12)
            tube(build, [(grip - half, 0, 0), (half, 0, 0)], 0.4 * thick, build.draw("metal"), sides=10)
        if head:
            box(build, (half - head / 2, -head, 0), (half, head, 2 * thick), build.draw("metal"))
        return []

    return Furnishing(length, 2 * max(thick, head), 2 * thick, add)


def laptop(rng: np.random.Generator) -> Furnishing:
    """An open laptop."""
    wide = float(rng.uniform(0.28, 0.38))
    deep = 0.68 * wide

    def add(build: RoomBuilder) -> list[Top]:
        case = build.draw("metal")
        box(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, 0.014), case)
        box(build, (-0.46 * wide, -0.1 * deep, 0.014), (0.46 * wide, 0.4 * deep, 0.0155), build.draw("screen"),
            bevel=0)  # fmt: skip
        with build.placed(0, deep / 2, 0.012), build.tilted(-build.rng.uniform(5, 25)):
            box(build, (-wide / 2, 0, 0), (wide / 2, 0.008, deep), case)
            panel(build, (-0.47 * wide, -0.001, 0.03 * deep), (0.94 * wide, 0, 0), (0, 0, 0.93 * deep),
                  build.draw("screen", 1.0), stretch=0.0)  # fmt: skip
        return []

    return Furnishing(wide, 1.9 * deep, 1.06 * deep, add)


def keyboard(rng: np.random.Generator) -> Furnishing:
    """A keyboard with rows of keys."""
    wide, deep = float(rng.uniform(0.28, 0.45)), float(rng.uniform(0.11, 0.15))

    def add(build: RoomBuilder) -> list[Top]:
        box(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, 0.016), build.draw("plastic"))
        key, step = build.draw("plastic"), deep / 6
        for k in range(5):
            for x in np.arange(-wide / 2 + step, wide / 2 - step, 2 * step):
                y = (k - 2.4) * step
                box(build, (x - 0.9 * step, y, 0.016), (x + 0.9 * step, y + 0.85 * step, 0.022), key, bevel=0)
        return []

    return Furnishing(wide, deep, 0.022, add)


def monitor(rng: np.random.Generator) -> Furnishing:
    """A screen on a foot."""
    wide = float(rng.uniform(0.4, 0.75))
    tall = wide * float(rng.uniform(0.55, 0.65))

    def add(build: RoomBuilder) -> list[Top]:
        case = build.draw("plastic")
        box(build, (-0.2 * wide, -0.09, 0), (0.2 * wide, 0.09, 0.012), case)
        tube(build, [(0, 0.03, 0.01), (0, 0.03, 0.4 * tall)], 0.02, case)
        with build.placed(0, 0, 0.1), build.tilted(-build.rng.uniform(0, 8)):
            box(build, (-wide / 2, -0.02, 0), (wide / 2, 0.015, tall), case)
            panel(build, (0.012 - wide / 2, -0.021, 0.015), (wide - 0.024, 0, 0), (0, 0, tall - 0.03),
                  build.draw("screen", 1.0), stretch=0.0)  # fmt: skip
        return []

    return Furnishing(wide, 0.2, tall + 0.1, add)


def phone(rng: np.random.Generator) -> Furnishing:
    """A telephone, a remote control or a game pad lying flat."""
    wide, deep, tall = rng.uniform(0.04, 0.09), rng.uniform(0.12, 0.2), rng.uniform(0.008, 0.025)

    def add(build: RoomBuilder) -> list[Top]:
        cushion(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall), 0.35 * tall, build.draw("plastic"),
                flat_steps=2)  # fmt: skip
        top = build.draw("screen", float(deep))
        box(build, (-0.4 * wide, -0.42 * deep, tall), (0.4 * wide, 0.42 * deep, tall + 0.0007), top, bevel=0)
        return []

    return Furnishing(wide, deep, tall, add)
