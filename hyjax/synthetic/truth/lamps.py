"""Lamps that light the photos of a random room: ceiling panels, hanging and standing globes."""

import numpy as np

from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import blackbody
from hyjax.light.kinds import Light, PointLight, RectLight
from hyjax.synthetic.random_room.builder import RoomBuilder
from hyjax.synthetic.shapes import box, revolve, tube
from hyjax.synthetic.truth.picture import Bulb

FREE_RADIUS = 0.3
"""Radius of free space around a lamp, in metres."""
TRIES = 60
"""Most draws of a lamp's place."""
LUMENS_PER_AREA = (90.0, 170.0)
"""Range of the flux of all lamps per floor area, in lumens per square metre."""


def add_lamps(
    build: RoomBuilder, caster: RayCaster, size: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[list[Light], dict[str, dict[str, object]], list[Bulb]]:
    """Put lamps of random kinds into a room. Returns their light, their places as anchors, and the round ones.

    Args:
        size: of the room, metres.
        count: of lamps; fewer where there is no place.
    """
    lights: list[Light] = []
    anchors: dict[str, dict[str, object]] = {}
    bulbs: list[Bulb] = []
    shares = rng.uniform(0.6, 1.4, count)
    total = rng.uniform(*LUMENS_PER_AREA) * size[0] * size[1]
    taken: list[np.ndarray] = []
    for share in total * shares / shares.sum():
        kind = str(rng.choice(["panel", "hanging", "standing"]))
        for _ in range(TRIES):
            place = _place(kind, size, rng)
            if all(np.linalg.norm((place - p)[:2]) > 0.9 for p in taken) and _is_free(kind, caster, place, size):
                taken.append(place)
                color = np.asarray(blackbody(rng.uniform(2900, 4600)), np.float32)
                if kind == "panel":
                    lights.append(_panel(build, place, size[2], share, color, rng))
                else:
                    globe = _globe(build, kind, place, size[2], share, color, rng)
                    lights.append(globe)
                    bulbs.append(Bulb(place, float(globe.radius)))
                position = place - (0, 0, 0.15) if kind == "panel" else place
                anchors[f"lamp_{len(anchors)}"] = {"position": [float(x) for x in position]}
                break
    return lights, anchors, bulbs


def _place(kind: str, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if kind == "standing":
        x, y = rng.uniform(0.3, size[:2] - 0.3)
        if rng.random() < 0.7:  # near a wall
            axis = rng.integers(2)
            at = [x, y]
            at[axis] = rng.choice([0.35, size[axis] - 0.35])
            x, y = at
        return np.array([x, y, rng.uniform(1.2, 1.6)])
    x, y = rng.uniform(0.25, 0.75, 2) * size[:2]
    return np.array([x, y, size[2] - 0.03 if kind == "panel" else rng.uniform(1.75, size[2] - 0.35)])


def _is_free(kind: str, caster: RayCaster, place: np.ndarray, size: np.ndarray) -> bool:
    down, up = np.array([[0, 0, -1.0]]), np.array([[0, 0, 1.0]])
    if kind == "panel":
        corners = place + np.array([[x, y, -0.1] for x in (-0.6, 0, 0.6) for y in (-0.6, 0, 0.6)])
        below = caster.cast(corners, np.repeat(down, 9, 0)).distance
        above = caster.cast(corners, np.repeat(up, 9, 0)).distance
        return bool((below > 0.5).all() and (above > 0.08).all() and (above < 0.2).all())
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    if caster.cast(place, ring).distance.min() < FREE_RADIUS:
        return False
    if kind == "hanging":
        above, below = caster.cast(place[None], up).distance[0], caster.cast(place[None], down).distance[0]
        return bool(abs(above - (size[2] - place[2])) < 0.02 and below > 0.5)
    below = caster.cast(place[None], down).distance[0]
    low = caster.cast(place * (1, 1, 0) + (0, 0, 0.3), ring).distance.min()
    return bool(abs(below - place[2]) < 0.03 and low > 0.2)


def _panel(
    build: RoomBuilder, place: np.ndarray, high: float, flux: float, color: np.ndarray, rng: np.random.Generator
) -> RectLight:
    x, y = rng.uniform(0.2, 0.6), rng.uniform(0.12, 0.35)
    x, y = (x, y) if rng.random() < 0.5 else (y, x)
    with build.placed(place[0], place[1]):
        low, top = (-x - 0.01, -y - 0.01, high - 0.03), (x + 0.01, y + 0.01, high + 0.002)
        box(build, low, top, build.draw("ceiling"))
    centre = np.array([place[0], place[1], high - 0.032], np.float32)
    return RectLight(
        centre, np.array([x, 0, 0], np.float32), np.array([0, -y, 0], np.float32), np.float32(flux), color
    )


def _globe(
    build: RoomBuilder,
    kind: str,
    place: np.ndarray,
    high: float,
    flux: float,
    color: np.ndarray,
    rng: np.random.Generator,
) -> PointLight:
    radius = rng.uniform(0.06, 0.12)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 17)
    ball = [(radius * np.cos(a), place[2] + radius * np.sin(a)) for a in angle]
    with build.placed(place[0], place[1]):
        revolve(build, ball, build.draw("ceiling"), sides=32)
        metal = build.draw("metal")
        if kind == "hanging":
            tube(build, [(0, 0, place[2] + radius), (0, 0, high)], 0.004, metal, sides=6)
        else:
            tube(build, [(0, 0, 0.02), (0, 0, place[2] - radius)], 0.011, metal, sides=10)
            revolve(build, [(0, 0), (0.14, 0), (0.14, 0.016), (0, 0.02)], metal, sides=32)
    return PointLight(
        place.astype(np.float32), np.float32(flux), color, np.float32(radius), np.float32(radius + 0.03)
    )
