"""Layout of the built-in room: furniture and small things at their places, and the room's anchors."""

import numpy as np

from hyjax.synthetic.room import furniture, things
from hyjax.synthetic.room import materials as m
from hyjax.synthetic.room.shell import DEPTH, HEIGHT, STEEL, WIDTH, add_shell
from hyjax.synthetic.shapes import box, cushion
from hyjax.synthetic.surface import Builder, Surface

TABLE = (1.42, 1.62)
SOFA = (WIDTH - 0.50, 3.30)
RUG = (2.62, 3.30)
BOOKCASE = (2.02, DEPTH - 0.004)


def arrange(seed: int) -> tuple[Surface, dict[str, dict[str, object]]]:
    """Build the whole room and its anchors."""
    build = Builder(seed)
    add_shell(build)
    _dining(build)
    _lounge(build)
    _shelf_wall(build)
    _door_wall(build)
    _plants(build)
    build.anchors["room_center"] = {"position": [WIDTH / 2, DEPTH / 2, HEIGHT / 2]}
    build.anchors["bounds"] = {"low": [0.0, 0.0, 0.0], "high": [WIDTH, DEPTH, HEIGHT]}
    return build.finish(), build.anchors


def _glaze(build: Builder) -> tuple[float, float, float]:
    return things.GLAZES[build.rng.integers(len(things.GLAZES))]


def _dining(build: Builder) -> None:
    rng = build.rng
    seats = ((-0.36, -0.50, 180), (0.36, -0.47, 180), (-0.34, 0.52, 0), (0.42, 0.66, -24))
    with build.placed(*TABLE):
        furniture.add_table(build)
        furniture.add_pendant(build, "lamp_1", HEIGHT)
        for x, y, turn in seats:
            with build.placed(x + rng.uniform(-0.03, 0.03), y, 0, turn + rng.uniform(-8, 8)):
                furniture.add_chair(build, furniture.BEECH)
        build.anchors["table"] = {"position": build.world((0, 0, 0.75))}
        with build.placed(-0.05, 0.05, 0.75):
            things.bowl(build, 0.15, _glaze(build))
            for angle, tint in ((0.3, (0.45, 0.05, 0.03)), (2.4, (0.30, 0.36, 0.05)), (4.4, (0.62, 0.27, 0.03))):
                with build.placed(0.06 * np.cos(angle), 0.06 * np.sin(angle), 0.025):
                    things.fruit(build, 0.038, tint)
        with build.placed(0.36, -0.17, 0.75, rng.uniform(0, 360)):
            things.mug(build, _glaze(build))
        with build.placed(-0.42, -0.16, 0.75, rng.uniform(10, 40)):
            things.book_stack(build, 2)
        with build.placed(0.45, 0.20, 0.75):
            things.vase(build, 0.22, _glaze(build))


def _lounge(build: Builder) -> None:
    rng = build.rng
    with build.placed(*SOFA, 0, -90):
        furniture.add_sofa(build)
        build.anchors["sofa"] = {"position": build.world((0, -0.1, 0.45))}
    with build.placed(*RUG, 0, 90 + rng.uniform(-2, 2)):
        box(build, (-1.2, -0.85, 0.0), (1.2, 0.85, 0.012), m.RUG, bevel=0.004, grain="x", uv=(0, 0))
    with build.placed(RUG[0] - 0.02, RUG[1] + 0.05, 0.0, rng.uniform(0, 360)):
        furniture.add_coffee_table(build)
        with build.placed(0.12, 0.12, 0.41, rng.uniform(0, 360)):
            things.book_stack(build, 3)
        with build.placed(-0.17, 0.08, 0.41):
            things.bowl(build, 0.09, _glaze(build))
        with build.placed(0.04, -0.22, 0.41, rng.uniform(0, 360)):
            things.mug(build, _glaze(build))
    with build.placed(WIDTH - 0.38, DEPTH - 0.42):
        furniture.add_floor_lamp(build, "lamp_0")
    with build.placed(WIDTH, SOFA[1], 1.52, -90):
        things.framed_picture(build, 1.0, 0.70, STEEL)


def _shelf_wall(build: Builder) -> None:
    rng = build.rng
    width, half = 1.24, 0.62 - 0.03
    with build.placed(*BOOKCASE):
        tops = furniture.add_bookcase(build, width, 1.92, 5)
        room = tops[1] - tops[0] - 0.035
        things.book_row(build, -half, 0.18, tops[0], room)
        with build.placed(0.38, -0.15, tops[0]):
            things.storage_box(build, 0.34, 0.24, 0.22, (0.30, 0.33, 0.30))
        with build.placed(-0.36, -0.15, tops[1]):
            things.storage_box(build, 0.38, 0.24, 0.18, (0.55, 0.42, 0.26))
        things.book_row(build, -0.08, half, tops[1], room)
        things.book_row(build, -half, 0.02, tops[2], room)
        with build.placed(0.22, -0.15, tops[2]):
            things.vase(build, 0.27, _glaze(build))
        with build.placed(0.45, -0.15, tops[2], rng.uniform(-20, 20)):
            things.book_stack(build, 4)
        with build.placed(-0.42, -0.15, tops[3]):
            things.bowl(build, 0.11, _glaze(build))
        things.book_row(build, -0.22, 0.30, tops[3], room)
        with build.placed(0.45, -0.15, tops[3]):
            things.plant(build, 9, 0.26, 0.06, 0.14, (0.70, 0.66, 0.60))
        things.book_row(build, -half, -0.25, tops[4], room)
        with build.placed(0.0, -0.15, tops[4]):
            things.storage_box(build, 0.30, 0.22, 0.15, (0.62, 0.60, 0.55))
        with build.placed(0.36, -0.15, tops[4]):
            things.vase(build, 0.20, _glaze(build))
        with build.placed(0.30, -0.16, 1.92):
            things.storage_box(build, 0.40, 0.26, 0.20, (0.42, 0.30, 0.19))
        build.anchors["bookcase"] = {"position": build.world((0, -0.3, 1.0))}
    with build.placed(3.22, DEPTH, 1.50):
        things.framed_picture(build, 0.50, 0.66, furniture.OAK, 0.75)
    with build.placed(3.12, DEPTH - 0.34):
        things.basket(build, 0.20, 0.34)
        with build.placed(0, 0, 0.10, 30):
            cushion(build, (-0.14, -0.10, 0.0), (0.14, 0.10, 0.30), 0.06, m.WEAVE, (0.66, 0.52, 0.45))


def _door_wall(build: Builder) -> None:
    rng = build.rng
    with build.placed(1.45, 0.004, 0, 180):
        furniture.add_sideboard(build)
        with build.placed(0.52, -0.2, 0.78):
            things.plant(build, 14, 0.42, 0.085, 0.19, (0.46, 0.22, 0.13))
        with build.placed(-0.35, -0.2, 0.78, rng.uniform(-10, 10)):
            things.book_stack(build, 3)
        with build.placed(-0.60, -0.18, 0.78):
            things.vase(build, 0.30, _glaze(build))
        with build.placed(0.08, -0.2, 0.78):
            things.storage_box(build, 0.24, 0.18, 0.12, (0.50, 0.46, 0.38))
    for k, x in enumerate((1.02, 1.48, 1.94)):
        with build.placed(x, 0, 1.62, 180):
            things.framed_picture(build, 0.36, 0.46, furniture.OAK, 0.31 * k + 0.2)
    with build.placed(WIDTH, 1.25, 0, -90):
        box(build, (-0.55, -0.22, 1.36), (0.55, 0.0, 1.39), m.WOOD, furniture.OAK, bevel=0.003)
        things.book_row(build, -0.50, -0.12, 1.39, 0.3)
        with build.placed(0.05, -0.12, 1.39):
            things.vase(build, 0.22, _glaze(build))
        with build.placed(0.35, -0.12, 1.39):
            things.storage_box(build, 0.26, 0.18, 0.14, (0.55, 0.50, 0.44))


def _plants(build: Builder) -> None:
    with build.placed(0.62, DEPTH - 0.52):
        things.plant(build, 26, 1.45, 0.17, 0.46, (0.66, 0.63, 0.58))
    with build.placed(WIDTH - 0.40, 1.15):
        things.plant(build, 18, 0.95, 0.14, 0.37, (0.16, 0.20, 0.22))
