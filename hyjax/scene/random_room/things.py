"""Small things that lie about: each a `Piece` of random shape and size."""

from collections.abc import Callable

import numpy as np

from hyjax.scene.random_room.builder import RoomBuilder
from hyjax.scene.random_room.plan import Piece, Top
from hyjax.scene.room import things as made
from hyjax.scene.room.shapes import box, cushion, panel, revolve, sheet, tube

Make = Callable[[np.random.Generator], Piece]


def carton(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, deep, tall, add)


def _on(wide: float, deep: float, tall: float) -> Top:
    return Top((-wide / 2, -deep / 2), (wide / 2, deep / 2), tall, 0.3)


def block(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, deep, tall, add)


def turned(rng: np.random.Generator) -> Piece:
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

    return Piece(2 * radius, 2 * radius, 1.09 * tall, add)


def can(rng: np.random.Generator) -> Piece:
    """A tin or a jar with a printed label."""
    radius, tall = float(rng.uniform(0.025, 0.06)), float(rng.uniform(0.07, 0.2))

    def add(build: RoomBuilder) -> list[Top]:
        metal = build.draw("metal")
        revolve(build, [(0, 0), (radius, 0), (radius, tall), (0, tall)], metal, sides=28)
        label = [(1.01 * radius, 0.08 * tall), (1.01 * radius, 0.92 * tall)]
        revolve(build, label, build.draw("print", tall), sides=28)
        return []

    return Piece(2.1 * radius, 2.1 * radius, tall, add)


def ball(rng: np.random.Generator) -> Piece:
    """A ball, an egg or a fruit."""
    radius, squash = float(rng.uniform(0.025, 0.13)), float(rng.choice([1.0, 1.0, rng.uniform(0.7, 1.3)]))

    def add(build: RoomBuilder) -> list[Top]:
        angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
        role = str(build.rng.choice(["plastic", "glazed", "cloth", "print"]))
        line = [(radius * np.cos(a), radius * squash * (1 + np.sin(a))) for a in angle]
        revolve(build, line, build.draw(role), sides=28)
        return []

    return Piece(2 * radius, 2 * radius, 2 * radius * squash, add)


def mug(rng: np.random.Generator) -> Piece:
    """A mug with a handle."""
    size = float(rng.uniform(0.8, 1.3))

    def add(build: RoomBuilder) -> list[Top]:
        with build.scaled(size, size, size * build.rng.uniform(0.7, 1.2)), build.dressed():
            made.mug(build, (0.5, 0.5, 0.5))
        return []

    return Piece(0.14 * size, 0.14 * size, 0.12 * size, add)


def bowl(rng: np.random.Generator) -> Piece:
    """A bowl, perhaps with fruit."""
    radius = float(rng.uniform(0.06, 0.18))

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.bowl(build, radius, (0.5, 0.5, 0.5))
            for k in range(int(build.rng.integers(0, 5))):
                with build.placed(0.4 * radius * np.cos(2.1 * k), 0.4 * radius * np.sin(2.1 * k), 0.1 * radius):
                    made.fruit(build, 0.27 * radius, (0.1 * (k % 2), 0.2, 0.1))
        return []

    return Piece(2 * radius, 2 * radius, 0.6 * radius, add)


def plate(rng: np.random.Generator) -> Piece:
    """A flat plate."""
    radius = float(rng.uniform(0.07, 0.16))

    def add(build: RoomBuilder) -> list[Top]:
        line = [(0, 0), (0.6 * radius, 0), (radius, 0.018), (radius, 0.021), (0.62 * radius, 0.006), (0, 0.006)]
        revolve(build, line, build.draw("glazed", 2 * radius), sides=36, lay="above")
        return []

    return Piece(2 * radius, 2 * radius, 0.025, add)


def _book(build: RoomBuilder, wide: float, deep: float, thick: float) -> None:
    """A lying book: spine at -x, boards proud of the pages."""
    cover, board = build.draw("print", max(wide, deep)), min(0.003, thick / 5)
    x, y = wide / 2, deep / 2
    box(build, (-x, -y, 0), (x, y, board), cover, bevel=0, grain="x", uv=(0, 0))
    box(build, (-x, -y, thick - board), (x, y, thick), cover, bevel=0, grain="x", uv=(0, 0))
    box(build, (-x, -y, board), (board - x, y, thick - board), cover, bevel=0)
    pages = build.draw("page", 0.02)
    box(build, (board - x, 0.004 - y, board), (x - 0.004, y - 0.004, thick - board), pages, bevel=0)


def book_stack(rng: np.random.Generator) -> Piece:
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

    return Piece(1.3 * wide, 1.2 * deep, float(thick.sum()), add)


def upright_books(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, 0.2, tall, add, wall=True)


def paper(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, deep, 0.005 + curl, add)


def cable(rng: np.random.Generator) -> Piece:
    """A cord in curls."""
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

    return Piece(wide, deep, 4 * radius, add)


def tool(rng: np.random.Generator) -> Piece:
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

    return Piece(length, 2 * max(thick, head), 2 * thick, add)


def laptop(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, 1.9 * deep, 1.06 * deep, add)


def keyboard(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, deep, 0.022, add)


def monitor(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, 0.2, tall + 0.1, add)


def plant(rng: np.random.Generator) -> Piece:
    """A pot plant."""
    tall = float(rng.uniform(0.15, 0.5))
    spread, pot = 0.4 * tall, 0.17 * tall

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.plant(build, int(build.rng.integers(5, 12)), tall, pot, spread, (0.5, 0.5, 0.5))
        return []

    return Piece(2 * spread, 2 * spread, 1.2 * tall, add)


def framed(rng: np.random.Generator) -> Piece:
    """A photograph in a frame, leaning back on its stand."""
    wide, tall = rng.uniform(0.1, 0.3, 2)

    def add(build: RoomBuilder) -> list[Top]:
        lean = build.tilted(-build.rng.uniform(8, 18))
        with lean, build.placed(0, 0, tall / 2 + 0.003), build.scaled(0.5, 1, 0.5), build.dressed():
            made.framed_picture(build, 2 * wide, 2 * tall, (0.3, 0.2, 0.1))
        return []

    return Piece(wide, 0.45 * tall, tall, add, wall=True)


def lamp(rng: np.random.Generator) -> Piece:
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

    return Piece(2 * radius, 2 * radius, tall, add)


def basket(rng: np.random.Generator) -> Piece:
    """A basket or a bin."""
    radius = float(rng.uniform(0.08, 0.22))
    tall = radius * float(rng.uniform(0.6, 2))

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            made.basket(build, radius, tall)
        return []

    return Piece(2 * radius, 2 * radius, tall, add)


def cloth(rng: np.random.Generator) -> Piece:
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

    return Piece(wide, deep, high, add)


def phone(rng: np.random.Generator) -> Piece:
    """A telephone, a remote control or a game pad lying flat."""
    wide, deep, tall = rng.uniform(0.04, 0.09), rng.uniform(0.12, 0.2), rng.uniform(0.008, 0.025)

    def add(build: RoomBuilder) -> list[Top]:
        cushion(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall), 0.35 * tall, build.draw("plastic"),
                flat_steps=2)  # fmt: skip
        top = build.draw("screen", float(deep))
        box(build, (-0.4 * wide, -0.42 * deep, tall), (0.4 * wide, 0.42 * deep, tall + 0.0007), top, bevel=0)
        return []

    return Piece(wide, deep, tall, add)


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


def draw(rng: np.random.Generator, makers: dict[Make, float]) -> Piece:
    """One of the things, by weight."""
    weights = np.array(list(makers.values()))
    return list(makers)[rng.choice(len(weights), p=weights / weights.sum())](rng)
