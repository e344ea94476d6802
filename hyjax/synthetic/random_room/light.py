"""Light of random lamps, windows and surroundings, traced straight to the pixels of one picture.

Hard light (sun, bare bulbs, flashes) is traced at every pixel. Soft light (windows, panels, lamps of some size,
and what walls and things send back) is traced at every second pixel of every second row with few rays, whose noise
is then averaged over neighbours on the same surface.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.random_room.fittings import RoomWindow
from hyjax.synthetic.random_room.layout import RandomRoom
from hyjax.synthetic.random_room.looks import Looks
from hyjax.synthetic.surface import rows

OFFSET = 1.5e-3
"""Distance from the surface, in metres, where rays start."""
AREA_RAYS = 4
"""Number of rays to panels, shared by all of them."""
SKY_RAYS = 4
"""Number of rays into the hemisphere."""
BLOCK_SIDE = 4
"""Side, in samples, of the block over which soft light is averaged; its samples take different rays."""
OPEN_DISTANCE = 1.2
"""Distance, in metres, beyond which surfaces send back as much light as open space."""


@dataclasses.dataclass(frozen=True)
class Points:
    """Points to light: positions, unit normals and depth of n points, in metres."""

    position: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    depth: Float[np.ndarray, "n"]


@dataclasses.dataclass(frozen=True)
class RoundLight:
    """Round light: a small lamp, or the sun.

    Attributes:
        position: metres; a direction for the sun.
        radius: of the light in metres, 0 for hard shadows; of the sun in radians.
        color: power, as its irradiance at a metre; irradiance for the sun.
        axis, cosine: of the cone that a spot light fills; a cosine of -1 for all round.
        sun: whether it is infinitely far.
        slats: spacing of bars in front of it in metres or radians, 0 for none: striped light.
    """

    position: Float[np.ndarray, "3"]
    radius: float
    color: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    cosine: float = -1.0
    sun: bool = False
    slats: float = 0.0


@dataclasses.dataclass(frozen=True)
class Panel:
    """Rectangle that shines to one side: a window, a ceiling light."""

    window: RoomWindow
    color: Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True)
class Lighting:
    """Lights of a room. `above` and `below` are the colours of open space."""

    lamps: list[RoundLight]
    panels: list[Panel]
    above: Float[np.ndarray, "3"]
    below: Float[np.ndarray, "3"]


def _tinted(rng: np.random.Generator, power: float) -> np.ndarray:
    """Random tint from candle to blue sky, seldom coloured."""
    warm = rng.uniform(-0.35, 0.35)
    color = np.array([1 + warm, 1.0, 1 - warm])
    if rng.random() < 0.06:
        color = rng.uniform(0.2, 1.2, 3)
    return power * color


def draw_lighting(room: RandomRoom, rng: np.random.Generator) -> Lighting:
    """Draw the lights of a room: by day, by lamps, or both."""
    panels = [Panel(w, _tinted(rng, rng.uniform(1, 8))) for w in room.windows]
    down = np.array([0.0, 0.0, -1.0])
    if not panels or rng.random() < 0.4:
        half = rng.uniform(0.1, 0.6, 2)
        place = np.append(rng.uniform(0.2, 0.8, 2) * room.size[:2], room.size[2] - 0.02)
        ceiling = RoomWindow(place, np.array([half[0], 0, 0]), np.array([0, half[1], 0]), down)
        panels.append(Panel(ceiling, _tinted(rng, rng.uniform(2, 14))))
    lamps = []
    for _ in range(int(rng.choice([0, 1, 1, 2, 3]))):
        place = rng.uniform([0.2, 0.2, 1.2], room.size - (0.2, 0.2, 0.1))
        aim = rng.uniform([0, 0, 0], room.size * (1, 1, 0.5)) - place
        cosine = float(np.cos(np.radians(rng.uniform(15, 50)))) if rng.random() < 0.35 else -1.0
        slats = float(rng.choice([0.0, rng.uniform(0.03, 0.15)], p=[0.85, 0.15]))
        lamps.append(RoundLight(place, float(rng.choice([0.0, 0.0, 0.04, 0.12])), _tinted(rng, rng.uniform(0.3, 3)),
                          aim / np.linalg.norm(aim), cosine, slats=slats))  # fmt: skip
    if room.windows and rng.random() < 0.6:
        window = room.windows[rng.integers(len(room.windows))]
        toward = -window.normal + rng.uniform(-1, 1) * window.right / np.linalg.norm(window.right)
        toward = toward / np.linalg.norm(toward) + (0, 0, rng.uniform(0.2, 1.0))
        toward /= np.linalg.norm(toward)
        slats = float(rng.choice([0.0, 0.0, rng.uniform(0.01, 0.05)]))
        lamps.append(RoundLight(toward, 0.0, _tinted(rng, rng.uniform(2, 8)), -toward, sun=True, slats=slats))
    ambient = rng.uniform(0.08, 0.7)
    above = _tinted(rng, ambient)
    return Lighting(lamps, panels, above, above * rng.uniform(0.3, 0.8))


def flash(camera: Float[np.ndarray, "3"], rng: np.random.Generator) -> RoundLight:
    """Flash next to the camera."""
    return RoundLight(
        camera + rng.normal(0, 0.04, 3), 0.0, _tinted(rng, rng.uniform(0.3, 1.5)), np.array([0.0, 0.0, 1.0])
    )


def hard_light(
    lamp: RoundLight, caster: RayCaster, points: Points, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Irradiance / π of a lamp with its shadows, and unit directions towards it."""
    p = points.position
    way = np.broadcast_to(lamp.position.astype(np.float32), p.shape) - (0 if lamp.sun else p)
    if lamp.radius > 0:
        way = way + rng.standard_normal(p.shape, dtype=np.float32) * np.float32(0.5 * lamp.radius)
    squared = dot(way, way)
    unit = way / np.sqrt(squared)[:, None]
    strength = np.maximum(dot(points.normal, unit), 0)
    if not lamp.sun:
        strength /= np.maximum(squared, 0.01)
    if lamp.cosine > -1:
        inside = -(unit @ lamp.axis.astype(np.float32))
        strength *= np.clip((inside - lamp.cosine) / 0.03, 0, 1)
    if lamp.slats:
        place = p @ (0.0, 0.0, 1.0) / lamp.slats * 0.3 if lamp.sun else unit[:, 2] / lamp.slats
        strength *= np.clip(0.5 + 3 * np.sin(2 * np.pi * place), 0.1, 1)
    lit = np.flatnonzero(strength > 1e-4)
    start = p[lit] + OFFSET * points.normal[lit]
    shadow = caster.occluded(start, way[lit], 1e4 if lamp.sun else 0.999)
    strength[lit[shadow]] = 0.0
    return strength[:, None] * lamp.color.astype(np.float32), unit.astype(np.float32)


def _interleaved(shape: tuple[int, int], count: int, salt: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sample `count` points of the unit square per pixel; all points of a block fill it evenly (R2 sequence)."""
    block = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
    tiles = (-(-shape[0] // BLOCK_SIDE), -(-shape[1] // BLOCK_SIDE))
    points = []
    for k in range(count):
        u, v = (((block + k * BLOCK_SIDE**2) * step + salt) % 1.0 for step in (0.7548776662, 0.5698402910))
        points.append(
            tuple(np.tile(a, tiles)[: shape[0], : shape[1]].reshape(-1, 1).astype(np.float32) for a in (u, v))
        )
    return points  # type: ignore[return-value]


def soft_light(
    lighting: Lighting,
    caster: RayCaster,
    looks: Looks,
    look: np.ndarray,
    points: Points,
    shape: tuple[int, int],
    salt: float,
) -> Float[np.ndarray, "n 3"]:
    """Irradiance / π of panels and of open space on points laid out as a picture of `shape`.

    `look` is the look of every face of the mesh.
    """
    start = points.position + OFFSET * points.normal
    total = np.zeros_like(points.position)
    rays = max(1, AREA_RAYS // max(1, len(lighting.panels)))
    for number, panel in enumerate(lighting.panels):
        w = panel.window
        area = np.float32(4 * np.linalg.norm(w.right) * np.linalg.norm(w.up) / np.pi)
        centre, right, up = (a.astype(np.float32) for a in (w.centre + 0.01 * w.normal, w.right, w.up))
        for u, v in _interleaved(shape, rays, salt + 0.19 * number):
            way = centre + (2 * u - 1) * right + (2 * v - 1) * up - start
            there = -(way @ w.normal.astype(np.float32))
            weight = np.maximum(dot(points.normal, way), 0) * np.maximum(there, 0)
            weight *= area / np.maximum(dot(way, way), 0.02) ** 2
            lit = np.flatnonzero(weight > 1e-4)
            weight[lit[caster.occluded(start[lit], way[lit], 0.999)]] = 0
            total += weight[:, None] * (panel.color / rays).astype(np.float32)
    x, y = _frame(points.normal)
    above, below = lighting.above.astype(np.float32), lighting.below.astype(np.float32)
    for u, v in _interleaved(shape, SKY_RAYS, salt + 0.37):
        radius, angle = np.sqrt(u), np.float32(2 * np.pi) * v
        way = radius * (np.cos(angle) * x + np.sin(angle) * y) + np.sqrt(1 - u) * points.normal
        hits = caster.cast(start, way)
        up = 0.5 + 0.5 * way[:, 2:]
        open_space = below + (above - below) * up
        # Light sent back by what is hit: all of open space's if it is far, little if it is near.
        share = np.minimum(np.where(hits.hit, hits.distance, 1e3) / OPEN_DISTANCE, 1)[:, None].astype(np.float32)
        albedo = looks.mean(rows(look, hits.face))
        albedo[~hits.hit] = 1.5
        total += open_space * (0.25 + 0.75 * share) * (0.35 + 0.65 * albedo) / SKY_RAYS
    return total


def _frame(normal: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Tangent frames: two unit vectors for each normal (Duff et al., JCGT 6(1), 2017)."""
    sign = np.copysign(np.float32(1), normal[:, 2])
    a = -1 / (sign + normal[:, 2])
    b = normal[:, 0] * normal[:, 1] * a
    x = np.stack([1 + sign * normal[:, 0] ** 2 * a, sign * b, -sign * normal[:, 0]], -1)
    y = np.stack([b, sign + normal[:, 1] ** 2 * a, -normal[:, 1]], -1)
    return x, y


def dot(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Inner product of each row with its partner."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def alike(a: Points, b: Points) -> Bool[np.ndarray, "n"]:
    """Whether pairs of points lie on the same smooth surface: similar normals, and each near the other's plane."""
    turned = dot(a.normal, b.normal) > 0.92
    off = np.abs(dot(a.normal, b.position - a.position))
    return turned & (off < 0.012 * a.depth)


def smooth(light: Float[np.ndarray, "n 3"], points: Points, shape: tuple[int, int]) -> Float[np.ndarray, "n 3"]:
    """Average over a block of neighbours on the same surface, so that every sample gets the rays of all."""
    h, w = shape
    i, j = np.indices(shape)
    total, weight = light.copy(), np.ones(len(light), np.float32)
    for di in range(-BLOCK_SIDE // 2, BLOCK_SIDE // 2):
        for dj in range(-BLOCK_SIDE // 2, BLOCK_SIDE // 2):
            if di == 0 and dj == 0:
                continue
            near = (np.clip(i + di, 0, h - 1) * w + np.clip(j + dj, 0, w - 1)).ravel()
            other = Points(rows(points.position, near), rows(points.normal, near), points.depth)
            use = alike(points, other).astype(np.float32)
            total += use[:, None] * rows(light, near)
            weight += use
    return total / weight[:, None]
