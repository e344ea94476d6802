"""Small solids of revolution: bottles, tins, crockery, pots, lamps; each a `Furnishing`."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.plan import Furnishing, Top
from hyjax.synthetic.room import things as made
from hyjax.synthetic.shapes import revolve


def turned(rng: np.random.Generator) -> Furnishing:
    """A turned body: bottle, jar, vase, glass, skittle, candlestick."""
    tall = float(rng.uniform(0.06, 0.35))
    radius = float(tall * rng.uniform(0.12, 0.45))
    knots = rng.uniform(0.25, 1, int(rng.integers(3, 8)))
    at = np.linspace(0, 1, 20)
    if rng.random() < 0.5:  # a bottle: straight, shoulder, neck
        shoulder, neck = rng.uniform(0.45, 0.8), rng.uniform(0.2, 0.5)
        width = neck + (1 - neck) / (1 + np.exp((at - shoulder) * rng.uniform(15, 60)))
    else:
        width = np.interp(at, np.linspace(0, 1, len(knots)), knots)
        width = np.convolve(np.pad(width, 2, mode="edge"), np.ones(5) / 5, "valid")
    width = width / width.max() * radius

    def add(build: RoomBuilder) -> list[Top]:
        role = str(build.rng.choice(["glazed", "plastic", "metal", "wood"]))
        line = [(0.0, 0.0), (0.94 * width[0], 0.0), *zip(width, at * tall), (0.92 * width[-1], 1.004 * tall)]
        if build.rng.random() < 0.4 and width[-1] > 0.012:  # open at the top
            inner = 0.88 * width[-1]
            line += [(inner, tall), (inner, 0.8 * tall), (0.0, 0.8 * tall)]
        else:
            line.append((0.0, 1.004 * tall))
        revolve(build, line, build.draw(role, None if build.rng.random() < 0.5 else tall), sides=24)
        if build.rng.random() < 0.3:
            revolve(build, [(0.0, tall), (width[-1] * 1.08, tall), (width[-1] * 1.08, 1.08 * tall),
                            (0.0, 1.08 * tall)], build.draw("plastic"), sides=20)  # fmt: skip
        return []

    return Furnishing(2 * radius, 2 * radius, 1.09 * tall, add)


def can(rng: np.random.Generator) -> Furnishing:
    """A tin or a jar with a printed label."""
    radius, tall = float(rng.uniform(0.025, 0.06)), float(rng.uniform(0.07, 0.2))

    def add(build: RoomBuilder) -> list[Top]:
        metal = build.draw("metal")
        revolve(build, [(0, 0), (radius, 0), (radius, tall), (0, tall)], metal, sides=28)
        label = [(1.01 * radius, 0.08 * tall), (1.01 * radius, 0.92 * tall)]
        revolve(build, label, build.draw("print", tall), sides=28)
        return []

    return Furnishing(2.1 * radius, 2.1 * radius, tall, add)


def ball(rng: np.random.Generator) -> Furnishing:
    """A ball, an egg or a fruit."""
    radius, squash = float(rng.uniform(0.025, 0.13)), float(rng.choice([1.0, 1.0, rng.uniform(0.7, 1.3)]))

    def add(build: RoomBuilder) -> list[Top]:
        angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
        role = str(build.rng.choice(["plastic", "glazed", "cloth", "print"]))
        line = [(radius * np.cos(a), radius * squash * (1 + np.sin(a))) for a in angle]
        revolve(build, line, build.draw(role), sides=28)
        return []

    return Furnishing(2 * radius, 2 * radius, 2 * radius * squash, add)


def mug(rng: np.random.Generator) -> Furnishing:
    """A mug with a handle."""
    size = float(rng.uniform(0.8, 1.3))

    def add(build: RoomBuilder) -> list[Top]:
        with build.scaled(size, size, size * build.rng.uniform(0.7, 1.2)), build.dressed():
            made.mug(build, (0.5, 0.5, 0.5))
        return []

    return Furnishing(0.14 * size, 0.14 * size, 0.12 * size, add)


def bowl(rng: np.random.Generator) -> Furnishing:
    """A bowl, perhaps with fruit."""
    radius = float(rng.uniform(0.06, 0.18))

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.bowl(build, radius, (0.5, 0.5, 0.5))
            for k in range(int(build.rng.integers(0, 5))):
                with build.placed(0.4 * radius * np.cos(2.1 * k), 0.4 * radius * np.sin(2.1 * k), 0.1 * radius):
                    made.fruit(build, 0.27 * radius, (0.1 * (k % 2), 0.2, 0.1))
        return []

    return Furnishing(2 * radius, 2 * radius, 0.6 * radius, add)


def plate(rng: np.random.Generator) -> Furnishing:
    """A flat plate."""
    radius = float(rng.uniform(0.07, 0.16))

    def add(build: RoomBuilder) -> list[Top]:
        line = [(0, 0), (0.6 * radius, 0), (radius, 0.018), (radius, 0.021), (0.62 * radius, 0.006), (0, 0.006)]
        revolve(build, line, build.draw("glazed", 2 * radius), sides=36, lay="above")
        return []

    return Furnishing(2 * radius, 2 * radius, 0.025, add)


def plant(rng: np.random.Generator) -> Furnishing:
    """A pot plant."""
    tall = float(rng.uniform(0.15, 0.5))
    spread, pot = 0.4 * tall, 0.17 * tall

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.plant(build, int(build.rng.integers(5, 12)), tall, pot, spread, (0.5, 0.5, 0.5))
        return []

    return Furnishing(2 * spread, 2 * spread, 1.2 * tall, add)


def lamp(rng: np.random.Generator) -> Furnishing:
    """A table lamp."""
    tall = float(rng.uniform(0.25, 0.55))
    radius = float(tall * rng.uniform(0.25, 0.4))

    def add(build: RoomBuilder) -> list[Top]:
        foot = build.draw(str(build.rng.choice(["metal", "glazed", "wood"])))
        at = np.linspace(0, 1, 9)
        line = [(radius * (0.15 + 0.3 * np.sin(3 * a) * build.rng.uniform(0.3, 1)), 0.55 * tall * a) for a in at]
        revolve(
            build, [(0, 0), (0.5 * radius, 0), (0.5 * radius, 0.01), *line[1:], (0, 0.6 * tall)], foot, sides=24
        )
        low, high, z = radius, radius * build.rng.uniform(0.5, 0.95), 0.55 * tall
        shade = [(high - 0.003, tall), (low - 0.003, z), (low, z), (high, tall), (high - 0.003, tall)]
        revolve(build, shade, build.draw("cloth", 0.3), sides=32)
        return []

    return Furnishing(2 * radius, 2 * radius, tall, add)


def basket(rng: np.random.Generator) -> Furnishing:
    """A basket or a bin."""
    radius = float(rng.uniform(0.08, 0.22))
    tall = radius * float(rng.uniform(0.6, 2))

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.basket(build, radius, tall)
        return []

    return Furnishing(2 * radius, 2 * radius, tall, add)
