"""Fittings on walls and ceilings: windows, doors, lamps, pictures, shelves, screens, towels."""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.random_room.plan import Top
from hyjax.synthetic.room import furniture
from hyjax.synthetic.room import things as made
from hyjax.synthetic.shapes import box, panel, revolve, sheet, tube

REVEAL_DEPTH = 0.2
"""Depth of window reveals in metres."""


@dataclasses.dataclass(frozen=True)
class RoomWindow:
    """Window opening: its centre, half-axes and the normal into the room."""

    centre: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]


def add_window(build: RoomBuilder, hole: tuple[float, float, float, float]) -> RoomWindow:
    """Add reveals, frame, sill, curtains or a blind at random to a hole (x0, z0, x1, z1) in y = 0, room at -y."""
    rng = build.rng
    x0, z0, x1, z1 = hole
    dx, dz, deep, look, frame = x1 - x0, z1 - z0, REVEAL_DEPTH, build.draw("ceiling"), build.draw("lacquer")
    for origin, s, t in (
        ((x0, 0, z0), (dx, 0, 0), (0, deep, 0)), ((x0, deep, z1), (dx, 0, 0), (0, -deep, 0)),
        ((x0, 0, z0), (0, deep, 0), (0, 0, dz)), ((x1, deep, z0), (0, -deep, 0), (0, 0, dz)),
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
    here = np.array(build.world((0, 0, 0)))
    return RoomWindow(
        np.array(build.world(((x0 + x1) / 2, 0, (z0 + z1) / 2))),
        build.world((dx / 2, 0, 0)) - here,
        np.array([0, 0, dz / 2]),
        build.world((0, -1, 0)) - here,
    )


def add_door(build: RoomBuilder, wide: float, high: float) -> None:
    """Add a closed door in its frame on the wall y = 0."""
    rng = build.rng
    leaf, trim = build.draw("front"), build.draw("lacquer")
    a = wide / 2
    box(build, (-a, -0.02, 0.006), (a, 0.01, high), leaf, grain="z")
    for x0, x1, z in ((-a - 0.07, -a, 0.0), (a, a + 0.07, 0.0), (-a, a, high)):
        box(build, (x0, -0.03, z), (x1, 0, high + 0.07), trim, bevel=0.005)
    for z in (0.25, 1.15) if rng.random() < 0.6 else ():
        box(build, (0.14 - a, -0.028, z), (a - 0.14, -0.01, z + 0.7), leaf, bevel=0.008)
    metal = build.draw("metal")
    tube(build, [(a - 0.07, -0.02, 1), (a - 0.07, -0.07, 1), (a - 0.19, -0.07, 1)], 0.009, metal)


def add_pendant(build: RoomBuilder, size: Float[np.ndarray, "3"]) -> None:
    """Add a lamp hanging somewhere from the ceiling; it is switched off."""
    rng, h = build.rng, size[2]
    with build.placed(*rng.uniform(0.2, 0.8, 2) * size[:2]):
        if rng.random() < 0.5:
            with build.scaled(1, 1, h / 2.6), build.dressed():
                furniture.add_pendant(build, "lamp", 2.6)
            return
        radius, low = rng.uniform(0.08, 0.25), h - rng.uniform(0.3, 0.9)
        angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
        bowl = [(radius * np.cos(a), low + radius * (1 + np.sin(a))) for a in angle]
        revolve(build, bowl, build.draw("glazed", 2 * radius), sides=36)
        tube(build, [(0, 0, low + 2 * radius), (0, 0, h)], 0.004, build.draw("plastic"), sides=6)


def add_hanging(build: RoomBuilder, kind: float, wide: float, tall: float) -> list[Top]:
    """Add an object of a `kind` in [0, 1) on a wall y = 0 about the origin. Returns the places for more things."""
    rng = build.rng
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
        return [Top((-x, -deep), (x, 0.0), 0.025, max(0.1, z), "shelf")]
    elif kind < 0.9:  # a screen, a cupboard, a loudspeaker
        deep = rng.uniform(0.03, 0.25)
        box(build, (-x, -deep, -z), (x, 0, z), build.draw("plastic"))
        look = build.draw(str(rng.choice(["screen", "front", "cloth"])), 1.0)
        a, b = x - 0.02, z - 0.02
        panel(build, (-a, -deep - 0.001, -b), (2 * a, 0, 0), (0, 0, 2 * b), look, stretch=0)
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
    return []
