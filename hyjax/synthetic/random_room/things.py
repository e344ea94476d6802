"""Boxes, books, papers and cloth that lie about, each a `Furnishing`; and their weights by place."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.gadgets import cable, keyboard, laptop, monitor, phone, tool
from hyjax.synthetic.random_room.plan import Furnishing, Make, Top
from hyjax.synthetic.random_room.vessels import ball, basket, bowl, can, lamp, mug, plant, plate, turned
from hyjax.synthetic.room import things as made
from hyjax.synthetic.shapes import box, cushion, sheet


def carton(rng: np.random.Generator) -> Furnishing:
    """A printed box: cereals, tea, medicine, a toy."""
    wide, deep, tall = np.sort(rng.uniform(0.03, 0.3, 3))[[2, 0, 1]]
    if rng.random() < 0.6:
        wide, tall = tall, wide
    bevel = min(0.002, deep / 20)

    def add(build: RoomBuilder) -> list[Top]:
        look = build.draw("print", float(max(wide, tall)) * build.rng.choice([1.0, 0.7]))
        box(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall), look, bevel=bevel, grain="x",
            uv=(build.rng.choice([0.0, wide / 2]), 0.0))  # fmt: skip
        return [_on(wide, deep, tall)]

    return Furnishing(wide, deep, tall, add)


def _on(wide: float, deep: float, tall: float) -> Top:
    return Top((-wide / 2, -deep / 2), (wide / 2, deep / 2), tall, 0.3)


def block(rng: np.random.Generator) -> Furnishing:
    """A plain box: a case, a speaker, a brick, a tin."""
    wide, deep, tall = rng.uniform(0.03, 0.25, 3)
    role = str(rng.choice(["plastic", "wood", "metal", "lacquer", "cloth", "front"]))
    radius = float(rng.uniform(0.002, 0.3) * min(wide, deep, tall))

    def add(build: RoomBuilder) -> list[Top]:
        low, high = (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall)
        if build.rng.random() < 0.4:
            cushion(build, low, high, radius, build.draw(role), flat_steps=2)
        else:
            box(build, low, high, build.draw(role), bevel=radius / 3)
        return [_on(wide, deep, tall)]

    return Furnishing(wide, deep, tall, add)


def _book(build: RoomBuilder, wide: float, deep: float, thick: float) -> None:
    """A lying book: spine at -x, boards proud of the pages."""
    cover, board = build.draw("print", max(wide, deep)), min(0.003, thick / 5)
    x, y = wide / 2, deep / 2
    box(build, (-x, -y, 0), (x, y, board), cover, bevel=0, grain="x", uv=(0, 0))
    box(build, (-x, -y, thick - board), (x, y, thick), cover, bevel=0, grain="x", uv=(0, 0))
    box(build, (-x, -y, board), (board - x, y, thick - board), cover, bevel=0)
    pages = build.draw("page", 0.02)
    box(build, (board - x, 0.004 - y, board), (x - 0.004, y - 0.004, thick - board), pages, bevel=0)


def book_stack(rng: np.random.Generator) -> Furnishing:
    """Books or magazines lying on each other."""
    size, count = float(rng.uniform(0.7, 1.3)), int(rng.integers(1, 7))
    wide, deep = 0.16 * size, 0.23 * size
    thick = rng.uniform(0.004, 0.04, count)

    def add(build: RoomBuilder) -> list[Top]:
        z = 0.0
        for k in range(count):
            with build.placed(0, 0, z, build.rng.uniform(-15, 15) + 180 * build.rng.integers(2)):
                scale = build.rng.uniform(0.8, 1)
                _book(build, wide * scale, deep * scale, thick[k])
            z += thick[k]
        return [_on(0.6 * wide, 0.6 * deep, z)]

    return Furnishing(1.3 * wide, 1.2 * deep, float(thick.sum()), add)


def upright_books(rng: np.random.Generator) -> Furnishing:
    """A row of standing books, the last perhaps leaning."""
    wide, tall = float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.15, 0.3))

    def add(build: RoomBuilder) -> list[Top]:
        x, even = -wide / 2, build.rng.random() < 0.3
        pages = build.draw("page", 0.02)
        while (thick := build.rng.uniform(0.01, 0.045)) < wide / 2 - x:
            high = tall * (1 if even else build.rng.uniform(0.75, 1))
            deep = min(0.72 * high, 0.19)
            # Width 2π/n of the spine shows one copy of the pattern: title and ornament.
            cover = build.draw("print", high)
            with build.placed(x, 0, 0):
                box(build, (0, -0.095, 0), (thick, deep - 0.098, high), cover, bevel=0.001, grain="x")
                box(build, (0.003, -0.09, 0.01), (thick - 0.003, deep - 0.095, high + 0.001), pages, bevel=0)
            x += thick + 0.001
        return []

    return Furnishing(wide, 0.2, tall, add, wall=True)


def paper(rng: np.random.Generator) -> Furnishing:
    """A sheet of paper or a magazine lying flat, its far corner perhaps curled: hardly any relief, much print."""
    wide = float(rng.uniform(0.1, 0.3))
    deep = wide * float(rng.choice([1.41, 0.71, 1.0]))
    curl = float(rng.choice([0.0, 0.0, rng.uniform(0, 0.03)]))

    def add(build: RoomBuilder) -> list[Top]:
        look = build.draw(str(build.rng.choice(["paper", "paper", "photo", "print"])), max(wide, deep))
        t, s = np.meshgrid(np.linspace(-0.5, 0.5, 6), np.linspace(-0.5, 0.5, 6), indexing="ij")
        lift = 0.001 + build.rng.uniform(0, 0.003) + curl * np.clip(s + t - 0.2, 0, 1) ** 2 / 0.64
        sheet(build, np.stack([s * wide, t * deep, lift], -1), look, thickness=0.0006)
        return []

    return Furnishing(wide, deep, 0.005 + curl, add)


def framed(rng: np.random.Generator) -> Furnishing:
    """A photograph in a frame, leaning back on its stand."""
    wide, tall = rng.uniform(0.1, 0.3, 2)

    def add(build: RoomBuilder) -> list[Top]:
        lean = build.tilted(-build.rng.uniform(8, 18))
        with lean, build.placed(0, 0, tall / 2 + 0.003), build.scaled(0.5, 1, 0.5), build.dressed():
            made.framed_picture(build, 2 * wide, 2 * tall, (0.3, 0.2, 0.1))
        return []

    return Furnishing(wide, 0.45 * tall, tall, add, wall=True)


def cloth(rng: np.random.Generator) -> Furnishing:
    """A crumpled cloth or jacket thrown down."""
    wide, deep, high = rng.uniform(0.15, 0.45), rng.uniform(0.15, 0.4), rng.uniform(0.02, 0.09)

    def add(build: RoomBuilder) -> list[Top]:
        t, s = np.meshgrid(np.linspace(-1, 1, 25), np.linspace(-1, 1, 25), indexing="ij")
        a = build.rng.uniform(2, 7, 8) * build.rng.choice([-1, 1], 8)
        p = build.rng.uniform(0, 6, 8)
        folds = sum(np.sin(a[k] * s + a[k + 1] * t + p[k]) for k in range(7)) / 7
        rim = np.clip(1.6 * (1 - np.maximum(np.abs(s), np.abs(t))), 0, 1) ** 0.5
        z = 0.002 + high * rim * (0.45 + 0.55 * folds)
        z = np.maximum(z, 0.002)
        bend = 1 - 0.12 * np.sin(a[0] * t + p[0]) ** 2
        sheet(build, np.stack([s * wide / 2 * bend, t * deep / 2, z], -1), build.draw("cloth"), thickness=0.003)
        return []

    return Furnishing(wide, deep, high, add)


ON_TABLES: dict[Make, float] = {
    carton: 5, block: 2, turned: 3, can: 2, ball: 1, mug: 2, bowl: 1, plate: 1, book_stack: 2, upright_books: 0.7,
    paper: 4, cable: 1, tool: 2, laptop: 0.7, keyboard: 0.6, monitor: 0.7, plant: 0.6, framed: 0.7, lamp: 0.6,
    basket: 0.3, cloth: 0.8, phone: 1,
}  # fmt: skip
ON_SHELVES: dict[Make, float] = {
    upright_books: 8, carton: 3, block: 1, turned: 2, can: 1, book_stack: 2, framed: 1.5, bowl: 1, plant: 0.7,
    basket: 1, ball: 0.5, lamp: 0.2,
}  # fmt: skip
ON_FLOORS: dict[Make, float] = {
    carton: 2, block: 2, ball: 1, book_stack: 1, paper: 1, cable: 2, basket: 1.5, cloth: 1.5, plant: 0.7,
    turned: 0.7, tool: 0.5,
}  # fmt: skip
