"""Furniture of random sizes: each a `Furnishing`."""

import numpy as np

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.parts import add_fronts, add_legs
from hyjax.synthetic.random_room.plan import Furnishing, Make, Top
from hyjax.synthetic.random_room.seats import bed, chair, office_chair, sofa
from hyjax.synthetic.room import furniture as made
from hyjax.synthetic.room import things as small
from hyjax.synthetic.shapes import box, panel, revolve, tube


def table(rng: np.random.Generator, low: bool = False) -> Furnishing:
    """A table: rectangular or round, with legs, a foot or side walls."""
    wide, deep = rng.uniform(0.7, 2.2), rng.uniform(0.5, 1.0)
    tall = rng.uniform(0.3, 0.5) if low else rng.uniform(0.68, 0.95)
    if low:
        wide, deep = 0.6 * wide, 0.8 * deep
    thick = rng.uniform(0.012, 0.05)
    around = rng.random() < 0.2
    if around:
        wide = deep = max(deep, 0.6)

    def add(build: RoomBuilder) -> list[Top]:
        top = build.draw("worktop" if build.rng.random() < 0.8 else "cloth")
        leg = top if build.rng.random() < 0.4 else build.draw(str(build.rng.choice(["wood", "metal", "lacquer"])))
        under, x, y = tall - thick, wide / 2, deep / 2
        if around:
            edge = [(x - 0.004, under), (x, under + 0.004), (x, tall - 0.004), (x - 0.004, tall)]
            revolve(build, [(0, under), *edge, (0, tall)], top, sides=48, lay="above")
            tube(build, [(0, 0, 0.02), (0, 0, under)], build.rng.uniform(0.02, 0.06), leg, sides=16)
            revolve(build, [(0, 0), (0.6 * x, 0), (0.6 * x, 0.015), (0, 0.03)], leg, sides=32)
            return [Top((-0.68 * x, -0.68 * x), (0.68 * x, 0.68 * x), tall, 0.8)]
        box(build, (-x, -y, under), (x, y, tall), top, bevel=min(0.006, thick / 4), grain="x")
        if build.rng.random() < 0.15:
            for side in (-x, x - 0.03):
                box(build, (side, -y, 0), (side + 0.03, y, under), leg)
        else:
            add_legs(build, x - 0.06, y - 0.06, under, leg)
            if build.rng.random() < 0.6:
                for side in (-1, 1):
                    a, b = sorted((side * (y - 0.07), side * (y - 0.05)))
                    box(build, (0.06 - x, a, under - 0.07), (x - 0.06, b, under), leg)
        return [Top((-x, -y), (x, y), tall, 0.8)]

    return Furnishing(wide, deep, tall, add)


def coffee_table(rng: np.random.Generator) -> Furnishing:
    """A low table."""
    return table(rng, low=True)


def radiator(rng: np.random.Generator) -> Furnishing:
    """A radiator with ribs, or a flat one."""
    wide, low, high, flat = (
        rng.uniform(0.5, 1.6),
        rng.uniform(0.08, 0.15),
        rng.uniform(0.45, 0.7),
        rng.random() < 0.4,
    )

    def add(build: RoomBuilder) -> list[Top]:
        look = build.draw("lacquer")
        step = 0.055 if not flat else wide
        for x in np.arange(-wide / 2, wide / 2 - 0.5 * step, step):
            box(build, (x, -0.04, low), (x + 0.78 * step if not flat else x + step, 0.03, high), look, bevel=0.01)
        for z in (low + 0.05, high - 0.1):
            box(build, (-wide / 2, -0.02, z), (wide / 2 - 0.02, 0.05, z + 0.04), look)
        tube(
            build,
            [(wide / 2, 0, low + 0.05), (wide / 2 + 0.05, 0, low + 0.05), (wide / 2 + 0.05, 0, 0)],
            0.01,
            look,
        )
        return []

    return Furnishing(wide + 0.12, 0.12, high, add, wall=True)


def dining(rng: np.random.Generator) -> Furnishing:
    """A table with chairs round it, some pulled out."""
    desk = table(rng)
    places = []
    for side in (-1, 1):
        for x in np.arange(-desk.wide / 2 + 0.35, desk.wide / 2 - 0.3, 0.6):
            if rng.random() < 0.75:
                places.append((float(x), side * (desk.deep / 2 + rng.uniform(0.0, 0.25)), 180 * (side < 0)))
    style = int(rng.integers(1 << 30))

    def add(build: RoomBuilder) -> list[Top]:
        for x, y, turn in places:
            one = chair(np.random.default_rng(style))
            with build.placed(x, y + np.sign(y) * one.deep / 2, 0, turn + build.rng.uniform(-12, 12)):
                one.add(build)
        return desk.add(build)

    return Furnishing(desk.wide + 0.1, desk.deep + 1.6, max(desk.tall, 1.1), add)


def bookcase(rng: np.random.Generator) -> Furnishing:
    """Open shelves."""
    wide, tall = rng.uniform(0.5, 1.6), rng.uniform(0.7, 2.2)
    shelves = max(2, round(tall / rng.uniform(0.28, 0.45)))

    def add(build: RoomBuilder) -> list[Top]:
        with build.placed(0, 0.15), build.dressed():
            tops = made.add_bookcase(build, wide, tall, shelves)
        room, half = (tall - 0.08) / shelves - 0.04, wide / 2 - 0.03
        boards = [Top((-half, -0.13), (half, 0.13), z, room, "shelf") for z in tops]
        return [*boards, Top((-half, -0.13), (half, 0.13), tall, 0.3)]

    return Furnishing(wide, 0.3, tall, add, wall=True)


def cabinet(rng: np.random.Generator) -> Furnishing:
    """A cabinet, chest of drawers, sideboard or wardrobe."""
    wide, deep = rng.uniform(0.4, 1.8), rng.uniform(0.3, 0.6)
    tall = rng.uniform(0.5, 1.1) if rng.random() < 0.7 else rng.uniform(1.6, 2.2)
    foot = rng.choice([0.0, 0.06, 0.15])

    def add(build: RoomBuilder) -> list[Top]:
        body = build.draw("front")
        front = body if build.rng.random() < 0.5 else build.draw("front")
        x, y = wide / 2, deep / 2
        box(build, (-x, 0.02 - y, foot), (x, y, tall), body, bevel=0.003)
        add_fronts(build, 0.01 - x, x - 0.01, foot + 0.02, tall - 0.03, 0.02 - y, front)
        if foot:
            add_legs(build, x - 0.05, y - 0.06, foot, build.draw("metal"))
        return [Top((-x, 0.02 - y), (x, y), tall, 0.6)]

    return Furnishing(wide, deep + 0.07, tall, add, wall=True)


def counter(rng: np.random.Generator) -> Furnishing:
    """A kitchen worktop over cabinets, with a splashback and perhaps wall cabinets above."""
    wide, deep, tall = rng.uniform(1.2, 3.0), rng.uniform(0.55, 0.65), rng.uniform(0.85, 0.95)
    above = rng.random() < 0.6

    def add(build: RoomBuilder) -> list[Top]:
        body, top = build.draw("front"), build.draw("worktop")
        x, y = wide / 2, deep / 2
        box(build, (-x, 0.06 - y, 0), (x, y, 0.1), build.draw("lacquer"), bevel=0)
        box(build, (-x, 0.03 - y, 0.1), (x, y, tall - 0.04), body)
        add_fronts(build, -x, x, 0.1, tall - 0.05, 0.03 - y, body)
        box(build, (-x, -y, tall - 0.04), (x, y, tall), top, bevel=0.004)
        panel(build, (-x, y - 0.004, tall), (wide, 0, 0), (0, 0, 0.55), build.draw("wall"))
        if above:
            low, high = tall + 0.55, tall + 1.2
            box(build, (-x, y - 0.32, low), (x, y, high), body)
            add_fronts(build, -x, x, low, high, y - 0.32, body)
        return [Top((-x, -y), (x, y - 0.01), tall, 0.5)]

    return Furnishing(wide, deep + 0.07, tall + (1.2 if above else 0.55), add, wall=True)


def floor_lamp(rng: np.random.Generator) -> Furnishing:
    """A standing lamp."""
    scale = rng.uniform(0.8, 1.15)

    def add(build: RoomBuilder) -> list[Top]:
        with build.scaled(scale, scale, scale), build.dressed():
            made.add_floor_lamp(build, "lamp")
        return []

    return Furnishing(0.45 * scale, 0.45 * scale, 1.6 * scale, add)


def tall_plant(rng: np.random.Generator) -> Furnishing:
    """A big plant in a pot."""
    tall = rng.uniform(0.6, 1.5)

    def add(build: RoomBuilder) -> list[Top]:
        with build.dressed():
            pot = (float(build.rng.random()), 0.4, 0.4)
            small.plant(build, int(build.rng.integers(9, 20)), tall, 0.13 * tall + 0.03, 0.4, pot)
        return []

    return Furnishing(0.8, 0.8, 1.15 * tall, add)


def cases(rng: np.random.Generator) -> Furnishing:
    """Cartons, crates or suitcases piled up."""
    count = int(rng.integers(1, 5))
    size = rng.uniform(0.2, 0.6, (count, 3)) * (1, 0.8, 0.7)
    size[:, :2] = np.sort(size[:, :2], axis=0)[::-1]

    def add(build: RoomBuilder) -> list[Top]:
        z = 0.0
        for wide, deep, tall in size:
            look = build.draw(str(build.rng.choice(["print", "wood", "cloth", "plastic"])))
            with build.placed(0, 0, z, build.rng.uniform(-10, 10)):
                box(build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, tall), look)
                if build.rng.random() < 0.4:
                    a, b = wide / 2 + 0.005, deep / 2 + 0.005
                    box(build, (-a, -b, 0.75 * tall), (a, b, tall + 0.004), build.draw("plastic"))
            z += tall + 0.005
        return [Top((-0.3 * wide, -0.3 * deep), (0.3 * wide, 0.3 * deep), z, 0.4)]

    return Furnishing(size[:, 0].max() * 1.2, size[:, 1].max() * 1.3, size[:, 2].sum() + 0.02, add)


def machine(rng: np.random.Generator) -> Furnishing:
    """A refrigerator, washing machine or stove: a box with a door, knobs or a round window."""
    wide, deep = rng.uniform(0.5, 0.7), rng.uniform(0.55, 0.65)
    tall = float(rng.choice([0.85, rng.uniform(1.2, 1.9)]))

    def add(build: RoomBuilder) -> list[Top]:
        body, x, y = build.draw(str(build.rng.choice(["lacquer", "metal"]))), wide / 2, deep / 2
        box(build, (-x, 0.03 - y, 0.02), (x, y, tall), body, bevel=0.008)
        if tall < 1:
            with build.placed(0, 0.03 - y, 0.42), build.tilted(90):
                revolve(build, [(0.1, 0.02), (0.16, 0.03), (0.19, 0.02), (0.2, 0)], build.draw("metal"), sides=40)
                revolve(build, [(0, 0.004), (0.11, 0.004)][::-1], build.draw("screen"), sides=32)
            panel(
                build,
                (0.02 - x, 0.028 - y, tall - 0.12),
                (wide - 0.04, 0, 0),
                (0, 0, 0.1),
                build.draw("screen", 0.3),
            )
        else:
            split = build.rng.uniform(0.3, 0.7) * tall
            for low, high in ((0.04, split), (split + 0.006, tall - 0.01)):
                box(build, (0.004 - x, -y, low), (x - 0.004, 0.028 - y, high), body, bevel=0.006)
                tube(build, [(0.07 - x, -y - 0.03, high - 0.25), (0.07 - x, -y - 0.03, high - 0.05)], 0.01,
                     build.draw("metal"))  # fmt: skip
        return [Top((-x, 0.03 - y), (x, y), tall, 0.4)]

    return Furnishing(wide, deep + 0.08, tall, add, wall=True)


WALL_PIECES: dict[Make, float] = {
    bookcase: 3, cabinet: 4, counter: 2.5, sofa: 2, bed: 1, machine: 1, table: 1.5, cases: 0.5, radiator: 0.8,
}  # fmt: skip
FREE_PIECES: dict[Make, float] = {
    dining: 2.5, table: 2, coffee_table: 2, chair: 2, office_chair: 1.5, sofa: 0.7, floor_lamp: 0.8,
    tall_plant: 0.8, cases: 1,
}  # fmt: skip
