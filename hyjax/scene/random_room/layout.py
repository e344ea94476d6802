"""A random room: its shell, what stands in it, what hangs on its walls, and what lies about."""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.scene.random_room import pieces, things
from hyjax.scene.random_room.builder import Furnished, RoomBuilder
from hyjax.scene.random_room.looks import Bank, Looks
from hyjax.scene.random_room.plan import Piece, Plan, Top
from hyjax.scene.room import furniture
from hyjax.scene.room import things as made
from hyjax.scene.room.shapes import box, panel, revolve, sheet, tube

OVERLAP = 0.006
"""Walls, floor and ceiling reach this far into each other, so that no ray slips out where they meet."""
THICK = 0.2
"""Depth of window reveals in metres."""


@dataclasses.dataclass(frozen=True)
class Window:
    """An opening: its centre, half-axes and the normal into the room."""

    centre: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True)
class RandomRoom:
    """A room: metres, z up, one corner of the floor at the origin.

    Attributes:
        furnished: its triangles and looks.
        size: inner width (x), depth (y) and height (z).
        windows: openings to the sky.
        targets: (point, size) of what is worth a picture.
    """

    furnished: Furnished
    size: Float[np.ndarray, "3"]
    windows: list[Window]
    targets: list[tuple[np.ndarray, float]]


def furnish(rng: np.random.Generator, patterns: Bank) -> RandomRoom:
    """A room in looks of a bank."""
    build = RoomBuilder(rng, Looks(patterns))
    size = np.array([rng.uniform(2.4, 6.5), rng.uniform(2.4, 6.5), rng.uniform(2.3, 3.2)])
    room = _Room(build, size)
    room.shell()
    room.stand_at_walls(int(rng.integers(3, 11)))
    room.stand_free(int(rng.integers(2, 8)))
    room.hang(int(rng.integers(3, 18)))
    room.lie_about(int(rng.integers(0, 10)))
    return RandomRoom(build.furnished(), size, room.windows, build.targets)


class _Room:
    """A room while it is furnished.

    Walls are numbered north, east, south, west; on each, x runs to the right as seen from inside, -y into the room.
    """

    def __init__(self, build: RoomBuilder, size: np.ndarray) -> None:
        self.build, self.rng, self.size = build, build.rng, size
        w, d, h = size
        self.places = [(w / 2, d, 0), (w, d / 2, -90), (w / 2, 0, 180), (0, d / 2, 90)]
        self.length = [w, d, w, d]
        self.floor = Plan((0.02, 0.02), (w - 0.02, d - 0.02))
        self.walls = [Plan((-a / 2 + 0.05, 0.05), (a / 2 - 0.05, h - 0.05)) for a in self.length]
        self.windows: list[Window] = []

    def at_wall(self, wall: int, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0):  # type: ignore[no-untyped-def]
        """`build.placed` in a wall's axes."""
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
                    self._window(hole)
            if rng.random() < 0.3:
                self._door(wall)
        for _ in range(int(rng.choice([0, 0, 1, 2]))):
            self._pendant()
        for _ in range(int(rng.integers(0, 3))):  # pillars and chimneys: rooms are seldom plain rectangles
            wide, deep, wall = rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.7), int(rng.integers(4))
            x = rng.choice([-1, 1]) * (self.length[wall] - wide) / 2 if rng.random() < 0.5 else rng.uniform(-1, 1)
            if self._take(wall, x, wide, deep, h - 0.15):
                with self.at_wall(wall, x):
                    box(build, (-wide / 2, -deep, 0), (wide / 2, 0.01, h), same, bevel=0)

    def _pendant(self) -> None:
        """A lamp hanging from the ceiling; it lights nothing, as if switched off."""
        build, rng, h = self.build, self.rng, self.size[2]
        with build.placed(*rng.uniform(0.2, 0.8, 2) * self.size[:2]):
            if rng.random() < 0.5:
                with build.scaled(1, 1, h / 2.6), build.dressed():
                    furniture.add_pendant(build, "lamp", 2.6)
                return
            radius, low = rng.uniform(0.08, 0.25), h - rng.uniform(0.3, 0.9)
            angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
            bowl = [(radius * np.cos(a), low + radius * (1 + np.sin(a))) for a in angle]
            revolve(build, bowl, build.draw("glazed", 2 * radius), sides=36)
            tube(build, [(0, 0, low + 2 * radius), (0, 0, h)], 0.004, build.draw("plastic"), sides=6)

    def _take(self, wall: int, x: float, wide: float, deep: float, tall: float, gap: float = 0.0) -> bool:
        """Room on the floor and on the wall for something that stands with its back to the wall."""
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

    def _window(self, hole: tuple[float, float, float, float]) -> None:
        build, rng = self.build, self.rng
        x0, z0, x1, z1 = hole
        dx, dz, look, frame = x1 - x0, z1 - z0, build.draw("ceiling"), build.draw("lacquer")
        for origin, s, t in (
            ((x0, 0, z0), (dx, 0, 0), (0, THICK, 0)), ((x0, THICK, z1), (dx, 0, 0), (0, -THICK, 0)),
            ((x0, 0, z0), (0, THICK, 0), (0, 0, dz)), ((x1, THICK, z0), (0, -THICK, 0), (0, 0, dz)),
        ):  # fmt: skip
            panel(build, origin, s, t, look)
        bar, y0, y1 = rng.uniform(0.03, 0.07), 0.1, 0.15
        for low, high in (
            ((x0, y0, z0), (x1, y1, z0 + bar)), ((x0, y0, z1 - bar), (x1, y1, z1)),
            ((x0, y0, z0), (x0 + bar, y1, z1)), ((x1 - bar, y0, z0), (x1, y1, z1)),
        ):  # fmt: skip
            box(build, low, high, frame, bevel=0.004)
        for k in range(1, int(rng.integers(1, 4))):
            x = x0 + dx * k / 3
            box(build, (x - bar / 2, y0, z0), (x + bar / 2, y1, z1), frame, bevel=0.004)
        box(build, (x0 - 0.05, -0.05, z0 - 0.03), (x1 + 0.05, 0.1, z0 + 0.003), frame, bevel=0.004)
        kind = rng.random()
        if kind < 0.35:
            cloth = build.draw("cloth")
            for left in (x0 - 0.25, x1 - 0.15):
                along, up = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 6))
                wave = 2 * np.pi * rng.integers(3, 7) * along + rng.uniform(0, 6)
                y = -0.09 - 0.03 * np.sin(wave) * (1.2 - 0.4 * up)
                sheet(build, np.stack([left + 0.4 * along, y, 0.05 + up * (z1 + 0.05)], -1), cloth, thickness=0.002)
            tube(build, [(x0 - 0.35, -0.09, z1 + 0.11), (x1 + 0.35, -0.09, z1 + 0.11)], 0.012, build.draw("metal"))
        elif kind < 0.6:  # a blind, pulled down some way
            slat, drop = build.draw("ceiling"), rng.uniform(0.2, 1.0)
            for z in np.arange(z1 - 0.05, z1 - drop * dz, -0.05):
                with build.placed(0, 0.05, z), build.tilted(rng.uniform(20, 50)):
                    box(build, (x0 + 0.01, -0.022, 0), (x1 - 0.01, 0.022, 0.0015), slat, bevel=0)
        self.windows.append(
            Window(
                np.array(build.world(((x0 + x1) / 2, 0, (z0 + z1) / 2))),
                np.array(build.world((dx / 2, 0, 0))) - build.world((0, 0, 0)),
                np.array([0, 0, dz / 2]),
                np.array(build.world((0, -1, 0))) - build.world((0, 0, 0)),
            )
        )

    def _door(self, wall: int) -> None:
        build, rng = self.build, self.rng
        wide, high = rng.uniform(0.7, 1.0), rng.uniform(1.95, 2.1)
        x = rng.uniform(-1, 1) * (self.length[wall] - wide - 0.4) / 2
        if not self._take(wall, x, wide + 0.2, 0.5, high + 0.1):
            return
        leaf, trim = build.draw("front"), build.draw("lacquer")
        with self.at_wall(wall, x):
            a = wide / 2
            box(build, (-a, -0.02, 0.006), (a, 0.01, high), leaf, grain="z")
            for x0, x1, z in ((-a - 0.07, -a, 0.0), (a, a + 0.07, 0.0), (-a, a, high)):
                box(build, (x0, -0.03, z), (x1, 0, high + 0.07), trim, bevel=0.005)
            for z in (0.25, 1.15) if rng.random() < 0.6 else ():
                box(build, (0.14 - a, -0.028, z), (a - 0.14, -0.01, z + 0.7), leaf, bevel=0.008)
            metal = build.draw("metal")
            tube(build, [(a - 0.07, -0.02, 1), (a - 0.07, -0.07, 1), (a - 0.19, -0.07, 1)], 0.009, metal)

    def stand_at_walls(self, count: int) -> None:
        for _ in range(count):
            piece, wall = things.draw(self.rng, pieces.WALL_PIECES), int(self.rng.integers(4))
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
            piece = things.draw(self.rng, pieces.FREE_PIECES)
            for _ in range(5):
                x, y = self.rng.uniform(0.3, self.size[:2] - 0.3)
                turn = self.rng.choice([0, 90, 180, 270]) + self.rng.normal(0, 8) * self.rng.integers(2)
                if piece.tall < self.size[2] - 0.1 and self.floor.take(x, y, piece.wide, piece.deep, turn):
                    with self.build.placed(x, y, 0, turn):
                        self._add(piece)
                    break

    def _add(self, piece: Piece) -> None:
        for top in piece.add(self.build):
            self._scatter(top)
        middle = np.array(self.build.world((0, -0.2 * piece.deep, 0.6 * piece.tall)))
        self.build.targets.append((middle, max(piece.wide, piece.tall)))

    def _scatter(self, top: Top, deeper: bool = True) -> None:
        """Put things on a top until what was wanted is there or no place is left."""
        rng, (x0, y0), (x1, y1) = self.rng, top.low, top.high
        area = (x1 - x0) * (y1 - y0)
        shelf = top.kind == "shelf"
        wanted = rng.poisson(area * rng.choice([6, 18, 40])) if deeper else int(rng.random() < 0.3)
        wanted = min(wanted, 22)
        plan, put = Plan((x0, y0), (x1, y1)), 0
        left = x0
        for _ in range(3 * wanted if not shelf else int(4 * (x1 - x0) / 0.3) + 2):
            thing = things.draw(rng, things.ON_SHELVES if shelf else things.ON_TABLES)
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
            thing = things.draw(self.rng, things.ON_FLOORS)
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
                self._hung(kind, wide, tall)

    def _hung(self, kind: float, wide: float, tall: float) -> None:
        rng, build = self.rng, self.build
        x, z = wide / 2, tall / 2
        if kind < 0.45:  # a poster or a note: no relief to speak of
            look = build.draw(str(rng.choice(["photo", "paper", "print"])), 1.0)
            panel(build, (-x, -0.003, -z), (wide, 0, 0), (0, 0, tall), look, stretch=0.0)
        elif kind < 0.65:
            with build.dressed():
                made.framed_picture(build, max(wide, 0.2), max(tall, 0.2), (0.3, 0.2, 0.1))
        elif kind < 0.8:  # a shelf with things on it
            deep = rng.uniform(0.12, 0.28)
            box(build, (-x, -deep, 0), (x, 0, 0.025), build.draw("wood"))
            with build.placed(0, -deep / 2):
                self._scatter(Top((-x, -deep / 2), (x, deep / 2), 0.025, max(0.1, z), "shelf"))
        elif kind < 0.9:  # a screen, a cupboard, a loudspeaker
            deep = rng.uniform(0.03, 0.25)
            box(build, (-x, -deep, -z), (x, 0, z), build.draw("plastic"))
            look = build.draw(str(rng.choice(["screen", "front", "cloth"])), 1.0)
            panel(
                build,
                (0.02 - x, -deep - 0.001, 0.02 - z),
                (wide - 0.04, 0, 0),
                (0, 0, tall - 0.04),
                look,
                stretch=0,
            )
        elif kind < 0.95:  # a towel or a coat on a hook
            across, up = np.meshgrid(np.linspace(-1, 1, 24), np.linspace(0, 1, 12))
            wave = np.sin(across * rng.uniform(4, 12) + rng.uniform(0, 6) + up) * (1 - 0.7 * up)
            spread = 1 - rng.uniform(0, 0.8) * up**3
            cloth = np.stack([x * across * spread, -0.05 - 0.03 * wave, tall * up - z], -1)
            sheet(build, cloth, build.draw("cloth"), thickness=0.004)
            tube(build, [(0, 0, z), (0, -0.07, z), (0, -0.08, z + 0.03)], 0.008, build.draw("metal"), sides=8)
        else:  # a clock or a plate
            radius = min(x, z)
            with build.tilted(90):
                rim = [(radius, 0), (radius, 0.03), (0.92 * radius, 0.035), (0.9 * radius, 0.02), (0, 0.02)]
                revolve(build, rim, build.draw("glazed", 2 * radius), sides=40, lay="above")
        tops = np.array(build.world((0, -0.1, 0)))
        build.targets.append((tops, max(wide, tall)))
