"""Baked diffuse light: sky through the window, then bounces between texels.

Every texel casts its rays once. Where they end is remembered, so that a further bounce is a table lookup and five
bounces cost hardly more than one. Neighbouring texels take different, interleaved rays; a small filter then merges
them, which gives each texel the smoothness of sixteen times its own rays.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import correlate1d

from hyjax.geometry.raycast import RayCaster
from hyjax.synthetic.room.daylight import sky_radiance
from hyjax.synthetic.room.lightmap import Texels, at_hits, select
from hyjax.synthetic.room.shell import WALL_THICKNESS, WINDOW
from hyjax.synthetic.surface import Surface, rows

BOUNCES = 6
CHUNK_RAYS = 1 << 17
"""Number of rays in flight per thread."""
OFFSET = 2e-3
"""Distance from a texel, in metres, where its rays start: curved charts bulge that far over their triangles."""
WORKERS = 2


class Gathered(NamedTuple):
    """Rays of some texels: origin and normal of each texel, direction of each ray, whether it hit and which texel;
    and each texel's mean distance, and whether it is in the open."""

    origin: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n*k 3"]
    hit: Bool[np.ndarray, "n*k"]
    hit_texels: Int[np.ndarray, "n k"]
    distance: Float[np.ndarray, "n"]
    valid: Bool[np.ndarray, "n"]


def bake(
    surface: Surface, caster: RayCaster, texels: Texels, albedo: Float[np.ndarray, "c 3"], side: int, seed: int
) -> Float[np.ndarray, "t 3"]:
    """Bake the light of all charts: irradiance / π of each texel.

    Args:
        surface: the room.
        caster: its rays.
        texels: of its light maps.
        albedo: mean albedo of each chart.
        side: each texel casts side² rays for bounces and as many towards the window.
        seed: of the jitter.
    """
    lobe, square = patterns(side, seed)
    y0, y1, z0, z1 = WINDOW
    y, z = y0 + square[..., 0] * (y1 - y0), z0 + square[..., 1] * (z1 - z0)
    opening = np.stack([np.full_like(y, -WALL_THICKNESS), y, z], axis=-1).astype(np.float32)

    def work(chunk: slice) -> tuple[np.ndarray, ...]:
        rays = gather(surface, caster, texels, chunk, lobe)
        direct = _direct(caster, rays, opening[group(texels, chunk, 2)])
        return direct, rays.distance, rays.valid, rays.hit_texels

    with ThreadPoolExecutor(WORKERS) as pool:
        parts = list(pool.map(work, chunks_of(texels, side)))
    direct, distance, valid = (np.concatenate([part[k] for part in parts]) for k in range(3))
    indirect = bounced(direct, texels, albedo, valid, [part[3] for part in parts])
    return smooth(texels, direct, indirect, distance, valid)


def chunks_of(texels: Texels, side: int) -> list[slice]:
    """Chunks of texels that cast `CHUNK_RAYS` rays each, of side² a texel."""
    step = max(1, CHUNK_RAYS // side**2)
    return [slice(a, min(a + step, len(texels))) for a in range(0, len(texels), step)]


def bounced(
    direct: Float[np.ndarray, "t 3"],
    texels: Texels,
    albedo: Float[np.ndarray, "c 3"],
    valid: Bool[np.ndarray, "t"],
    hit_texels: Sequence[Int[np.ndarray, "n k"]],
) -> Float[np.ndarray, "t 3"]:
    """Indirect light from direct light after `BOUNCES` bounces, see `gather`."""
    reflectance = np.where(valid[:, None], albedo[texels.chart], 0.0).astype(np.float32)
    total, indirect = direct, np.zeros_like(direct)
    with ThreadPoolExecutor(WORKERS) as pool:
        for _ in range(BOUNCES):
            # One dark row more: rays that leave, or meet a back side, point at it.
            radiance = np.concatenate([reflectance * total, np.zeros((1, 3), np.float32)])
            indirect = np.concatenate(list(pool.map(lambda hit: _mean_of(radiance, hit), hit_texels)))  # noqa: B023
            total = direct + indirect
    return indirect


def _mean_of(values: Float[np.ndarray, "t 3"], index: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n 3"]:
    total = np.zeros((len(index), 3), np.float32)
    for k in range(index.shape[1]):
        total += rows(values, index[:, k])
    return total / index.shape[1]


def _strata(side: int, cell: int, rng: np.random.Generator) -> Float[np.ndarray, "g k 2"]:
    """Strata: `cell`² groups of side² points in the unit square, even in each group and over all groups."""
    base = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(1, -1, 2)
    shift = np.stack(np.meshgrid(np.arange(cell), np.arange(cell)), axis=-1).reshape(-1, 1, 2)
    jitter = rng.random((cell * cell, side * side, 2))
    return ((base + (shift + jitter) / cell) / side).astype(np.float32)


def group(texels: Texels, chunk: slice, cell: int) -> Int[np.ndarray, "n"]:
    """Group of rays of each texel; neighbours take different ones."""
    order = np.random.default_rng(0).permutation(cell * cell)
    return order[texels.i[chunk] % cell + cell * (texels.j[chunk] % cell)]


def patterns(side: int, seed: int) -> tuple[Float[np.ndarray, "16 k 3"], Float[np.ndarray, "4 k 2"]]:
    """Directions about +z for sixteen neighbouring texels, and points of the unit square for four."""
    rng = np.random.default_rng((seed, 2))
    return _cosine_lobe(_strata(side, 4, rng)).astype(np.float32), _strata(side, 2, rng)


def gather(
    surface: Surface, caster: RayCaster, texels: Texels, chunk: slice, lobe: Float[np.ndarray, "16 k 3"]
) -> Gathered:
    """Cast the rays of a chunk of texels. Those that leave or meet a back side hit a texel beyond the last one."""
    normal = texels.normal[chunk]
    origin = texels.position[chunk] + OFFSET * normal
    n, rays = len(origin), lobe.shape[1]
    direction = np.matmul(lobe[group(texels, chunk, 4)], _frames(normal)).reshape(-1, 3)
    hits = caster.cast(np.repeat(origin, rays, axis=0), direction)
    front = np.einsum("nk,nk->n", rows(surface.mesh.face_normals, hits.face), direction) < 0
    hit_texels = np.full(n * rays, len(texels), np.int32)
    lit = hits.hit & front
    chosen = select(hits, lit)
    hit_texels[lit] = texels.nearest(rows(surface.chart, chosen.face), at_hits(surface.st, chosen))
    near = np.minimum(np.where(hits.hit, hits.distance, 10.0), 10.0).reshape(n, rays)
    inside = (hits.hit & ~front).reshape(n, rays).mean(axis=1)
    distance = 1 / (1 / (near + 1e-3)).mean(axis=1)
    return Gathered(origin, normal, direction, hits.hit, hit_texels.reshape(n, rays), distance, inside < 0.4)


def _direct(caster: RayCaster, rays: Gathered, target: Float[np.ndarray, "n k 3"]) -> Float[np.ndarray, "n 3"]:
    """Light of the sky: by rays that leave through the window, and by points in its opening."""
    n, count = rays.hit_texels.shape
    miss = np.flatnonzero(~rays.hit & (rays.direction[:, 0] < 0))
    texel, direction = miss // count, rays.direction[miss]
    escaped = np.zeros((n * count, 3), np.float32)
    share = _window_share(rays.origin[texel], direction, rays.normal[texel])
    escaped[miss] = sky_radiance(direction) * (1 - share)[:, None]
    y0, y1, z0, z1 = WINDOW
    area, inward = (y1 - y0) * (z1 - z0), np.array([1.0, 0.0, 0.0])
    through = from_rectangle(caster, target, inward, area, sky_radiance, rays.origin, rays.normal)
    return escaped.reshape(n, count, 3).mean(axis=1) + through


def _cosine_lobe(square: Float[np.ndarray, "g k 2"]) -> Float[np.ndarray, "g k 3"]:
    """Cosine-weighted directions about +z from points of the unit square (Shirley's concentric map)."""
    a, b = 2 * square[..., 0] - 1, 2 * square[..., 1] - 1
    wide = np.abs(a) > np.abs(b)
    r = np.where(wide, a, b)
    ratio = np.where(wide, b, a) / np.where(np.abs(r) < 1e-9, 1.0, r)
    angle = np.where(wide, ratio * (np.pi / 4), np.pi / 2 - ratio * (np.pi / 4))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.sqrt(np.maximum(1 - r * r, 1e-6))], axis=-1)


def _frames(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Right-handed frames with z along the normals, as rows x, y and z."""
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(normal, x), normal], axis=1).astype(np.float32)


def _window_share(origin: np.ndarray, direction: np.ndarray, normal: np.ndarray) -> Float[np.ndarray, "n"]:
    """Weight of window sampling against cosine sampling for rays that leave (balance heuristic)."""
    y0, y1, z0, z1 = WINDOW
    facing = np.maximum(-direction[:, 0], 1e-6)
    distance = (origin[:, 0] + WALL_THICKNESS) / facing
    by_window = distance**2 / (facing * (y1 - y0) * (z1 - z0))
    by_cosine = np.maximum(np.einsum("nk,nk->n", direction, normal), 0) / np.pi
    return by_window / (by_window + by_cosine)


def from_rectangle(
    caster: RayCaster,
    target: Float[np.ndarray, "n k 3"],
    inward: Float[np.ndarray, "3"],
    area: float,
    radiance: Callable[[Float[np.ndarray, "m 3"]], Float[np.ndarray, "m 3"]],
    origin: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Irradiance / π from points of a rectangle, without the part that cosine sampling finds better.

    Args:
        inward: unit normal of the rectangle.
        radiance: by unit directions towards it.
    """
    to = (target - origin[:, None]).astype(np.float32)
    distance = np.sqrt(np.einsum("nkd,nkd->nk", to, to))
    to /= np.maximum(distance, 1e-6)[..., None]
    cosine = np.einsum("nkd,nd->nk", to, normal)
    facing = -(to @ inward.astype(np.float32))
    ask = (cosine > 0) & (facing > 1e-4)
    index = np.nonzero(ask)
    direction = to[ask]
    free = ~caster.occluded(origin[index[0]], direction)
    index = (index[0][free], index[1][free])
    by_window = distance[index] ** 2 / (facing[index] * area)
    by_cosine = cosine[index] / np.pi
    light = np.zeros((*ask.shape, 3), np.float32)
    light[index] = radiance(direction[free]) * (by_cosine / (by_window + by_cosine))[:, None]
    return light.mean(axis=1)


def smooth(
    texels: Texels, direct: np.ndarray, indirect: np.ndarray, distance: np.ndarray, valid: np.ndarray
) -> Float[np.ndarray, "t 3"]:
    """Merge the interleaved rays of neighbours, wider where nothing is near; fill texels inside solids.

    Charts of one shape are filtered together: there are thousands of them, most with a handful of texels.
    """
    total = np.empty_like(direct)
    shapes, member = np.unique(np.stack([texels.rows, texels.columns], axis=1), axis=0, return_inverse=True)
    for k, shape in enumerate(shapes):
        charts = np.flatnonzero(member.reshape(-1) == k)
        part = texels.start[charts][:, None] + np.arange(shape[0] * shape[1])
        block = (len(charts), *shape)
        weight = valid[part].reshape(*block, 1).astype(np.float32)
        d, i = (a[part].reshape(*block, 3) for a in (direct, indirect))
        far = distance[part].reshape(block) / texels.pitch[charts][:, None, None]
        i = _merge(i, weight, (0.5, 1, 1, 1, 0.5))
        wide = _merge(i, weight, (0.5, 0, 1, 0, 1, 0, 1, 0, 0.5))
        i = i + (wide - i) * np.clip(far / 8 - 0.5, 0, 1)[..., None]
        light = _merge(d, weight, (0.5, 1, 0.5)) + i
        for _ in range(8):
            if weight.all():
                break
            filled = _merge(light, weight, (1, 1, 1))
            light = np.where(weight > 0, light, filled)
            weight = np.maximum(weight, (filled.sum(axis=-1, keepdims=True) > 0).astype(np.float32))
        total[part.ravel()] = light.reshape(-1, 3)
    return total


def _merge(values: np.ndarray, weight: np.ndarray, taps: tuple[float, ...]) -> Float[np.ndarray, "b r c 3"]:
    """Weighted mean over neighbours along rows and columns."""
    both = np.concatenate([values * weight, weight], axis=-1)
    for axis in (1, 2):
        if both.shape[axis] > 1:
            both = correlate1d(both, np.array(taps), axis=axis, mode="reflect")
    return (both[..., :3] / np.maximum(both[..., 3:], 1e-6)).astype(np.float32)
