"""Sources of light in a room, and their direct light on points: Monte Carlo with shadow rays.

The truth of one of our lights (`hyjax.light.kinds`) is its own `illuminance_at`, times the share of its emitter
that shadow rays reach: the ball of a bulb, the area of a rectangle, the disc of the sun.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_dilation

from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import Light
from hyjax.light.kinds.emitter import Emitter
from hyjax.util.vectors import orthonormal_frame, r2_sequence, unit

OFFSET = 2e-3
"""Distance from the surface, in metres, where shadow rays start."""
CHUNK_POINTS = 1 << 16
"""Number of points whose illuminance is computed at once, padded: JAX compiles for one shape."""
PROBE_SAMPLES = 4
"""Number of samples that decide whether a point lies in a penumbra."""
LEAST_DISTANCE = 0.05
"""Least distance from a bulb, in metres, in the illuminance of points."""


@dataclasses.dataclass(frozen=True)
class Daylight:
    """Daylight through one window.

    Attributes:
        window: its number.
        color: radiance in multiples of `hyjax.synthetic.room.daylight.sky_radiance`.
    """

    window: int
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)


Source = Daylight | Light


def hard_lights(sources: Sequence[Source]) -> list[Light]:
    """Sources with sharp shadows: bulbs, spots, sun."""
    lights = [s for s in sources if isinstance(s, Light)]
    return [light for light in lights if (e := light.emitter()) is not None and e.kind not in ("rect", "sky")]


def soft_lights(sources: Sequence[Source]) -> list[Light]:
    """Sources with soft shadows: rectangles. Skies come in through the openings; ambient light is left out."""
    lights = [s for s in sources if isinstance(s, Light)]
    return [light for light in lights if (e := light.emitter()) is not None and e.kind == "rect"]


def direct(
    light: Light,
    caster: RayCaster,
    position: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    samples: int,
    turn: Float[np.ndarray, "n 2"],
    start: Float[np.ndarray, "n 3"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Irradiance / π of a light with its shadows.

    Args:
        turn: shifts the samples of each point by a share of the unit square.
        start: of the shadow rays; by default a hair above the surface.
    """
    emitter = light.emitter()
    assert emitter is not None
    lux = unshadowed(light, position, normal)
    lit = np.flatnonzero(lux > 0)
    total = np.zeros((len(position), 3), np.float32)
    if not lit.size:
        return total
    n, shift = normal[lit], turn[lit]
    begin = (position[lit] + OFFSET * n) if start is None else start[lit]
    few = min(PROBE_SAMPLES, samples) if emitter.kind != "rect" else samples
    share = _visible_share(emitter, caster, begin, n, few, shift)
    if emitter.extent > 0 and few < samples:
        # Only a penumbra is worth all samples: where a few of them differ, or differ from the neighbours'.
        edge = binary_dilation((share > 0) & (share < 1) | (share != np.roll(share, 1)), iterations=2)
        share[edge] = _visible_share(emitter, caster, begin[edge], n[edge], samples, shift[edge])
    total[lit] = (lux[lit] * share / np.pi)[:, None] * np.asarray(light.color, np.float32)
    return total


def unshadowed(
    light: Light, position: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Illuminance (lux) by the light's own definition, without shadow and colour; bounded near a bulb."""
    parts = []
    for k in range(0, len(position), CHUNK_POINTS):
        p, n = (np.asarray(a[k : k + CHUNK_POINTS], np.float32) for a in (position, normal))
        pad = ((0, CHUNK_POINTS - len(p)), (0, 0))
        parts.append(np.asarray(_lux(light, np.pad(p, pad), np.pad(n, pad)))[: len(p)])
    lux = np.concatenate(parts) if parts else np.zeros(0, np.float32)
    emitter = light.emitter()
    if emitter is not None and emitter.kind in ("point", "spot"):
        squared = ((position - emitter.position) ** 2).sum(axis=1)
        lux = lux * np.minimum(squared / max(LEAST_DISTANCE, emitter.extent) ** 2, 1)
    return lux.astype(np.float32)


@jax.jit
def _lux(light: Light, position: np.ndarray, normal: np.ndarray) -> jax.Array:
    return light.illuminance_at(position, normal)  # type: ignore[arg-type]


def _visible_share(
    emitter: Emitter, caster: RayCaster, start: np.ndarray, normal: np.ndarray, samples: int, turn: np.ndarray
) -> Float[np.ndarray, "n"]:
    """Share of the emitter that reaches each point; a rectangle's parts count by their form factors."""
    if emitter.extent == 0 and emitter.kind != "rect":
        samples = 1
    square = (r2_sequence(samples)[None] + turn[:, None]) % 1.0
    weight, mean = np.ones(square.shape[:2], np.float32), samples * np.ones(len(start), np.float32)
    if emitter.kind == "directional":
        way, reach = _to_sun(emitter, start, square)
        weight[reach <= 0] = 0
    elif emitter.kind == "rect":
        way, weight = _to_rectangle(emitter, start, normal, square)
        reach = np.full(weight.shape, 0.999, np.float32)
        mean = weight.sum(axis=1)
    else:
        way, reach = _to_bulb(emitter, start, square)
    ask = (weight > 0) & (reach > 0)
    index = np.nonzero(ask)
    blocked = caster.occluded(start[index[0]], way[index], reach[index])
    weight[index[0][blocked], index[1][blocked]] = 0
    return weight.sum(axis=1) / np.maximum(mean, 1e-12)


def _to_bulb(emitter: Emitter, start: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to the visible disc of a ball, and their share that is open to shadow casters."""
    to = emitter.position - start
    distance = np.linalg.norm(to, axis=1)
    x, y, _ = np.moveaxis(orthonormal_frame(np.where(distance[:, None] > 1e-9, to, [0, 0, 1.0])), -2, 0)
    a, b = np.moveaxis(_disc(square) * emitter.extent, -1, 0)
    way = to[:, None] + a[..., None] * x[:, None] + b[..., None] * y[:, None]
    reach = 1 - max(emitter.clearance, 1e-3) / np.maximum(distance, 1e-6)
    return way, np.broadcast_to(reach[:, None], square.shape[:2]).copy()


def _to_sun(emitter: Emitter, start: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to the disc of the sun, and distances to its aperture; negative where they miss it."""
    x, y, z = orthonormal_frame(-np.asarray(emitter.direction))
    disc = _disc(square) * np.tan(emitter.extent)
    way = unit(z + disc[..., :1] * x + disc[..., 1:] * y)
    if emitter.aperture is None:
        return way, np.full(way.shape[:2], 1e4)
    centre, right, up = (
        np.asarray(v, np.float64) for v in (emitter.aperture.center, emitter.aperture.right, emitter.aperture.up)
    )
    across = unit(np.cross(right, up))
    facing = way @ across
    reach = ((centre - start) @ across)[:, None] / np.where(np.abs(facing) < 1e-9, 1e-9, facing)
    at = start[:, None] + reach[..., None] * way - centre
    inside = reach > 0
    for axis in (right, up):
        inside &= np.abs(at @ axis) <= axis @ axis
    return way, np.where(inside, reach, -1.0)


def _to_rectangle(
    emitter: Emitter, start: np.ndarray, normal: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to points of a rectangle, and their form factors up to a constant."""
    right, up = np.asarray(emitter.right), np.asarray(emitter.up)
    place = 2 * square - 1
    way = emitter.position + place[..., :1] * right + place[..., 1:] * up - start[:, None]
    squared = np.einsum("nkd,nkd->nk", way, way)
    cosine = np.maximum(np.einsum("nkd,nd->nk", way, normal), 0)
    there = np.maximum(-(way @ unit(np.cross(right, up))), 0)
    return way, (cosine * there / np.maximum(squared, 1e-6) ** 2).astype(np.float32)


def _disc(square: Float[np.ndarray, "n k 2"]) -> Float[np.ndarray, "n k 2"]:
    radius, angle = np.sqrt(square[..., 0]), 2 * np.pi * square[..., 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
