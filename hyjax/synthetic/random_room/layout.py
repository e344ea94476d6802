"""Random room: its shell, furniture, wall decorations, and small objects."""

import contextlib
import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.random_room import pieces, things
from hyjax.synthetic.random_room.bank import Bank
from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.fittings import RoomWindow, add_door, add_hanging, add_pendant, add_window
from hyjax.synthetic.random_room.looks import Looks
from hyjax.synthetic.random_room.plan import FloorPlan, Furnishing, Top, draw
from hyjax.synthetic.shapes import box, panel
from hyjax.synthetic.surface import Surface

OVERLAP = 0.006
"""Overlap of walls, floor and ceiling in metres, so that no ray slips out where they meet."""


@dataclasses.dataclass(frozen=True)
class RandomRoom:
    """Random room: metres, z up, one corner of the floor at the origin.

    Attributes:
        surface: its triangles, whose materials are looks; vertices are split at hard edges.
        looks: of its triangles.
        size: inner width (x), depth (y) and height (z).
        windows: openings to the sky.
        targets: (point, size) of objects worth a picture.
    """

    surface: Surface
    looks: Looks
    size: Float[np.ndarray, "3"]
    windows: list[RoomWindow]
    targets: list[tuple[np.ndarray, float]]


def furnish(rng: np.random.Generator, patterns: Bank) -> RandomRoom:
    """Furnish a room in looks of a bank."""
    build, size, windows = plan(rng, patterns)
    return RandomRoom(build.finish(), build.looks, size, windows, build.targets)


def plan(rng: np.random.Generator, patterns: Bank) -> tuple[RoomBuilder, Float[np.ndarray, "3"], list[RoomWindow]]:
    """Plan a room that can be extended: its builder, size and windows, see `RandomRoom`."""
    build = RoomBuilder(rng, Looks(patterns))
    size = np.array([rng.uniform(2.4, 6.5), rng.uniform(2.4, 6.5), rng.uniform(2.3, 3.2)])
    room = _Room(build, size)
    room.shell()
    room.stand_at_walls(int(rng.integers(3, 11)))
    room.stand_free(int(rng.integers(2, 8)))
    room.hang(int(rng.integers(3, 18)))
    room.lie_about(int(rng.integers(0, 10)))
    return build, size, room.windows


class _Room:
    """Room in the course of furnishing.

    Walls are numbered north, east, south, west; on each, x runs to the right as seen from inside, -y into the room.
    """

    def __init__(self, build: RoomBuilder, size: np.ndarray) -> None:
        self.build, self.rng, self.size = build, build.rng, size
        w, d, h = size
        self.places = [(w / 2, d, 0), (w, d / 2, -90), (w / 2, 0, 180), (0, d / 2, 90)]
        self.length = [w, d, w, d]
        self.floor = FloorPlan((0.02, 0.02), (w - 0.02, d - 0.02))
        self.walls = [FloorPlan((-a / 2 + 0.05, 0.05), (a / 2 - 0.05, h - 0.05)) for a in self.length]
        self.windows: list[RoomWindow] = []

    def at_wall(
        self, wall: int, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0
    ) -> contextlib.AbstractContextManager[None]:
        """Context `build.placed` in a wall's axes."""
        cx, cy, angle = self.places[wall]
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        return self.build.placed(cx + c * x - s * y, cy + s * x + c * y, z, angle + turn)

    def shell(self) -> None:
        build, rng, e = self.build, self.rng, OVERLAP
        w, d, h = self.size
        same = build.draw("wall")
        panel(build, (-e, -e, 0), (w + 2 * e, 0, 0), (0, d + 2 * e, 0), build.draw("floor"))
        panel(build, (-e, -e, h), (0, d + 2 * e, 0), (w + 2 * e, 0, 0), build.draw("ceiling"))
        skirting = build.draw("lacquer") if rng.random() < 0.7 else None
        for wall in range(4):
            look = same if rng.random() < 0.65 else build.draw("wall")
            holes = self._openings(wall) if rng.random() < 0.45 else []
            a = self.length[wall] + 2 * e
            with self.at_wall(wall):
                cut = [(x0 + a / 2, z0 + e, x1 + a / 2, z1 + e) for x0, z0, x1, z1 in holes]
                panel(build, (-a / 2, 0, -e), (a, 0, 0), (0, 0, h + 2 * e), look, holes=cut)
                if skirting is not None:
                    box(build, (-a / 2, -0.016, 0), (a / 2, 0, 0.09), skirting, bevel=0.004)
                for hole in holes:
                    self.windows.append(add_window(build, hole))
            if rng.random() < 0.3:
                self._door(wall)
        for _ in range(int(rng.choice([0, 0, 1, 2]))):
            add_pendant(build, self.size)
        for _ in range(int(rng.integers(0, 3))):  # pillars and chimneys: rooms are seldom plain rectangles
            wide, deep, wall = rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.7), int(rng.integers(4))
            x = (rng.choice([-1, 1]) if rng.random() < 0.5 else rng.uniform(-1, 1)) * (self.length[wall] - wide) / 2
            if self._take(wall, x, wide, deep, h - 0.15):
                with self.at_wall(wall, x):
                    box(build, (-wide / 2, -deep, 0), (wide / 2, 0.01, h), same, bevel=0)

    def _take(self, wall: int, x: float, wide: float, deep: float, tall: float, gap: float = 0.0) -> bool:
        """Take space on the floor and on the wall for an object with its back to the wall."""
        cx, cy, angle = self.places[wall]
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        y = -deep / 2 - gap
        high = min(tall, self.size[2] - 0.1)
        if not self.walls[wall].take(x, 0.05 + high / 2, wide, high - 0.01, 0):
            return False
        # The plan of the floor keeps a hair off the walls.
        return self.floor.take(cx + c * x - s * y, cy + s * x + c * y, wide - 0.05, deep - 0.05, angle)

    def _openings(self, wall: int) -> list[tuple[float, float, float, float]]:
        rng, a, h = self.rng, self.length[wall], self.size[2]
        wide, low, high = rng.uniform(0.6, min(2.4, a - 0.8)), rng.uniform(0.4, 1.1), rng.uniform(1.9, h - 0.2)
        x = rng.uniform(0.3 + wide / 2 - a / 2, a / 2 - 0.3 - wide / 2)
        if not self.walls[wall].take(x, (low + high) / 2, wide + 0.1, high - low + 0.1, 0):
            return []
        return [(x - wide / 2, low, x + wide / 2, high)]

    def _door(self, wall: int) -> None:
        build, rng = self.build, self.rng
        wide, high = rng.uniform(0.7, 1.0), rng.uniform(1.95, 2.1)
        x = rng.uniform(-1, 1) * (self.length[wall] - wide - 0.4) / 2
        if not self._take(wall, x, wide + 0.2, 0.5, high + 0.1):
            return
        with self.at_wall(wall, x):
            add_door(build, wide, high)

    def stand_at_walls(self, count: int) -> None:
        for _ in range(count):
            piece, wall = draw(self.rng, pieces.WALL_PIECES), int(self.rng.integers(4))
            gap = float(self.rng.choice([0.0, 0.0, self.rng.uniform(0, 0.1)]))
            for _ in range(4):
                x = self.rng.uniform(-1, 1) * (self.length[wall] - piece.wide) / 2
                if piece.wide < self.length[wall] and self._take(wall, x, piece.wide, piece.deep, piece.tall, gap):
                    turn = 180.0 if not piece.wall and self.rng.random() < 0.5 else 0.0
                    with self.at_wall(wall, x, -piece.deep / 2 - gap - 0.017, 0, turn):
                        self._add(piece)
                    break

    def stand_free(self, count: int) -> None:
        if self.rng.random() < 0.45:
            wide, deep = self.rng.uniform(0.4, 0.8, 2) * self.size[:2]
            x, y = (self.size[:2] - (wide, deep)) * self.rng.random(2) + np.array([wide, deep]) / 2
            with self.build.placed(x, y):
                look = self.build.draw("rug", max(wide, deep) if self.rng.random() < 0.6 else None)
                box(self.build, (-wide / 2, -deep / 2, 0), (wide / 2, deep / 2, 0.01), look, uv=(0, 0))
        for _ in range(count):
            piece = draw(self.rng, pieces.FREE_PIECES)
            for _ in range(5):
                x, y = self.rng.uniform(0.3, self.size[:2] - 0.3)
                turn = self.rng.choice([0, 90, 180, 270]) + self.rng.normal(0, 8) * self.rng.integers(2)
                if piece.tall < self.size[2] - 0.1 and self.floor.take(x, y, piece.wide, piece.deep, turn):
                    with self.build.placed(x, y, 0, turn):
                        self._add(piece)
                    break

    def _add(self, piece: Furnishing) -> None:
        for top in piece.add(self.build):
            self._scatter(top)
        middle = np.array(self.build.world((0, -0.2 * piece.deep, 0.6 * piece.tall)))
        self.build.targets.append((middle, max(piece.wide, piece.tall)))

    def _scatter(self, top: Top, deeper: bool = True) -> None:
        """Scatter the wanted things on a top, as far as places are left."""
        rng, (x0, y0), (x1, y1) = self.rng, top.low, top.high
        area = (x1 - x0) * (y1 - y0)
        shelf = top.kind == "shelf"
        wanted = rng.poisson(area * rng.choice([6, 18, 40])) if deeper else int(rng.random() < 0.3)
        wanted = min(wanted, 22)
        plan, put = FloorPlan((x0, y0), (x1, y1)), 0
        left = x0
        for _ in range(3 * wanted if not shelf else int(4 * (x1 - x0) / 0.3) + 2):
            thing = draw(rng, things.ON_SHELVES if shelf else things.ON_TABLES)
            if thing.tall > top.room or thing.wide > x1 - x0 or thing.deep > y1 - y0:
                continue
            turn = rng.normal(0, 6) if shelf or thing.wall else rng.uniform(0, 360)
            if shelf:  # from left to right
                x, y = left + thing.wide / 2 + rng.exponential(0.03), (y1 - thing.deep / 2 - rng.uniform(0, 0.02))
                turn = 0.0 if thing.deep > 0.15 else turn
                y = y if abs(turn) < 1 else (y0 + y1) / 2
            else:
                x, y = rng.uniform((x0, y0), (x1, y1))
            if not plan.take(x, y, thing.wide, thing.deep, turn):
                continue
            left = x + thing.wide / 2 + 0.002
            with self.build.placed(x, y, top.z + 0.0004, turn):
                for further in thing.add(self.build):
                    if deeper and min(further.high[0] - further.low[0], further.high[1] - further.low[1]) > 0.08:
                        self._scatter(dataclasses.replace(further, room=top.room - further.z), deeper=False)
            put += 1
            if put >= wanted and not shelf:
                break
        if deeper and put:
            middle = np.array(self.build.world(((x0 + x1) / 2, (y0 + y1) / 2, top.z + 0.05)))
            self.build.targets.extend([(middle, max(0.3, min(1.2, x1 - x0)))] * min(put, 4))

    def lie_about(self, count: int) -> None:
        for _ in range(count):
            thing = draw(self.rng, things.ON_FLOORS)
            x, y = self.rng.uniform(0.1, self.size[:2] - 0.1)
            turn = self.rng.uniform(0, 360)
            if self.floor.take(x, y, thing.wide, thing.deep, turn):
                with self.build.placed(x, y, 0.011, turn):
                    thing.add(self.build)
                    self.build.targets.append((np.array(self.build.world((0, 0, 0.05))), 0.6))

    def hang(self, count: int) -> None:
        rng = self.rng
        for _ in range(count):
            wall, kind = int(rng.integers(4)), rng.random()
            wide, tall = rng.uniform(0.15, 1.0, 2)
            if kind < 0.3:
                wide, tall = 0.3 * wide + 0.1, 0.3 * tall + 0.1
            x = rng.uniform(-1, 1) * max(0.0, self.length[wall] - wide) / 2
            z = rng.uniform(0.8, 2.0)
            if not self.walls[wall].take(x, z, wide + 0.02, tall + 0.02, 0):
                continue
            with self.at_wall(wall, x, 0, z):
                for top in add_hanging(self.build, kind, wide, tall):
                    self._scatter(top)
                self.build.targets.append((np.array(self.build.world((0, -0.1, 0))), max(wide, tall)))
