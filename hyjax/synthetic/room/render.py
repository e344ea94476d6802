"""Renderer of the lit room: albedo × baked light, mirror reflections, and a camera's imperfections."""

import dataclasses
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter
from skimage.transform import resize

from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import Hits, RayCaster
from hyjax.synthetic.room.daylight import sky_radiance, view
from hyjax.synthetic.room.lightmap import Texels, at_hits, select
from hyjax.synthetic.room.materials import LEAF
from hyjax.synthetic.surface import Surface, rows
from hyjax.synthetic.tone_curve import encode, tone

WHITE_BALANCE = np.array([0.975, 1.0, 1.035], np.float32)
"""White balance, which removes most of the warmth of light from the walls and the floor."""
CONTRAST = 0.3
SHARPNESS = 0.7
"""Width of the texture filter in pixels; the lens blurs textures a little more."""
DEPTH_JUMP = 0.025
"""Relative jump of depth at a border, above that of a floor at a grazing angle."""
EDGE_SAMPLES = 7
"""Number of rays through a pixel with several surfaces."""
BLURS = (0.0, 2.0, 6.0)
"""Blurs of the mirror image that are mixed for rough reflections, in pixels at a width of 640."""
LIGHT_SAMPLES, EDGE_LIGHT_SAMPLES = 16, 2
"""Number of points of a hard light per pixel, and per ray through a pixel with several surfaces."""


class Paints(Protocol):
    """Albedo of materials, with mean, and strength and blur of reflections, see `Material`."""

    mean: Float[np.ndarray, "m 3"]
    gloss: Float[np.ndarray, "m"]
    blur: Float[np.ndarray, "m"]

    def __call__(
        self, material: Int[np.ndarray, "n"], uv: Float[np.ndarray, "n 2"], footprint: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n 3"]: ...


@dataclasses.dataclass(frozen=True)
class Lit:
    """Base of lit rooms, ready for photographs.

    Attributes:
        surface: the room.
        corners: (u, v, s, t) of the faces' corners.
        caster: the room's rays.
        textures: of its materials.
        exposure: that brings its light to display values, one for all channels or one for each.
        seed: of the camera's noise.
    """

    surface: Surface
    corners: Float[np.ndarray, "f 3 4"]
    caster: RayCaster
    textures: Paints
    exposure: float | Float[np.ndarray, "3"]
    seed: int

    def irradiance(
        self, origin: Float[np.ndarray, "*n 3"], rays: Float[np.ndarray, "n 3"], nearest: Hits,
        st: Float[np.ndarray, "n 2"], samples: int,
    ) -> Float[np.ndarray, "n 3"]:  # fmt: skip
        """Irradiance / π at the ends of rays; `samples` points of each hard light, 0 for the light map alone."""
        raise NotImplementedError

    def emitted(
        self, origin: Float[np.ndarray, "*n 3"], rays: Float[np.ndarray, "n 3"], nearest: Hits
    ) -> Float[np.ndarray, "n 3"] | None:
        """Radiance of lit lamps at the ends of rays; None if there are none."""
        return None

    def outside(
        self, origin: Float[np.ndarray, "*n 3"], rays: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Radiance outside along rays that leave the room."""
        raise NotImplementedError

    def mirrored_outside(
        self, origin: Float[np.ndarray, "n 3"], rays: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Radiance outside in a mirror image, without detail."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class BakedRoom(Lit):
    """Built-in room by day.

    Attributes:
        texels: of the light maps.
        light: irradiance / π of each texel, so that radiance is this times albedo.
    """

    texels: Texels
    light: Float[np.ndarray, "t 3"]

    def irradiance(
        self, origin: np.ndarray, rays: np.ndarray, nearest: Hits, st: np.ndarray, samples: int
    ) -> Float[np.ndarray, "n 3"]:
        return self.texels.lookup(self.light, rows(self.surface.chart, nearest.face), st)

    def outside(self, origin: np.ndarray, rays: np.ndarray) -> Float[np.ndarray, "n 3"]:
        return garden(self.textures, rays, LEAF) / self.exposure

    def mirrored_outside(self, origin: np.ndarray, rays: np.ndarray) -> Float[np.ndarray, "n 3"]:
        return sky_radiance(rays.astype(np.float32))


def photograph(baked: Lit, camera: Camera, number: int) -> Float[np.ndarray, "h w 3"]:
    """Photograph a frame: display-encoded picture in 8-bit steps."""
    h, w = camera.intrinsics.shape
    rng = np.random.default_rng((baked.seed, 1, number))
    rays = camera.rays().reshape(-1, 3)
    hits = baked.caster.cast(camera.origin, rays)
    depth = np.where(hits.hit, hits.distance, 0.0).astype(np.float32).reshape(h, w)
    pixel = 1.0 / camera.intrinsics.fx
    picture = _diffuse(baked, camera.origin, rays, hits, pixel, LIGHT_SAMPLES).reshape(h, w, 3)
    shared = _shared_pixels(baked.surface, hits, depth)
    picture[shared] = _supersample(baked, camera, shared, picture[shared], rng)
    mirror = _mirror(baked, camera, rays, hits, pixel)
    # One mirror ray a pixel is too few on an edge, which borrows from its neighbours instead.
    mirror[shared] = gaussian_filter(mirror, (1.0, 1.0, 0), truncate=2)[shared]
    picture += mirror
    return _develop(picture * baked.exposure, rng)


def _diffuse(
    baked: Lit,
    origin: Float[np.ndarray, "*n 3"],
    rays: Float[np.ndarray, "n 3"],
    hits: Hits,
    pixel: float | Float[np.ndarray, "n"],
    samples: int,
) -> Float[np.ndarray, "n 3"]:
    """Radiance along rays: albedo × light, or the view outside. `pixel` is the footprint a unit of distance."""
    surface = baked.surface
    radiance = np.empty((len(rays), 3), np.float32)
    miss = ~hits.hit
    radiance[miss] = baked.outside(_some(origin, miss), rays[miss])
    nearest = select(hits, hits.hit)
    direction = rays[hits.hit]
    normal = rows(surface.mesh.face_normals, nearest.face)
    cosine = np.abs(np.einsum("nk,nk->n", normal, direction)) / np.linalg.norm(direction, axis=1)
    width = np.broadcast_to(pixel, hits.face.shape)[hits.hit] * nearest.distance / np.sqrt(np.maximum(cosine, 0.02))
    uv_st = at_hits(baked.corners, nearest)
    albedo = baked.textures(rows(surface.material, nearest.face), uv_st[:, :2], SHARPNESS * width)
    start = _some(origin, hits.hit)
    irradiance = baked.irradiance(start, direction, nearest, uv_st[:, 2:], samples)
    radiance[hits.hit] = albedo * rows(surface.tint, nearest.face) * irradiance
    if (emitted := baked.emitted(start, direction, nearest)) is not None:
        radiance[hits.hit] += emitted
    return radiance


def _some(origin: Float[np.ndarray, "*n 3"], chosen: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "*k 3"]:
    """Select origins of some of the rays; one origin for all stays one."""
    return origin if origin.ndim == 1 else origin[chosen]


def garden(textures: Paints, rays: Float[np.ndarray, "n 3"], leaf: int) -> Float[np.ndarray, "n 3"]:
    """View outside by directions from a window that faces -x, in multiples of white; `leaf` is its foliage."""
    direction = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    place = np.stack([np.arctan2(direction[:, 1], -direction[:, 0]), direction[:, 2]], axis=-1)
    n = len(direction)
    row, width = np.full(n, leaf), np.full(n, 0.004, np.float32)
    foliage = textures(row, 0.9 * place, width) * 0.5 + textures(row, 3.7 * place, width) * 0.5
    return view(direction, foliage)


def _shared_pixels(surface: Surface, hits: Hits, depth: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Mask of pixels on borders between charts and on jumps of depth, which need antialiasing."""
    chart = np.where(hits.hit, rows(surface.chart, hits.face), -1).reshape(depth.shape)
    edge = np.zeros(depth.shape, dtype=bool)
    across, down = chart[:, 1:] != chart[:, :-1], chart[1:] != chart[:-1]
    across |= np.abs(np.diff(depth, axis=1)) > DEPTH_JUMP * depth[:, 1:]
    down |= np.abs(np.diff(depth, axis=0)) > DEPTH_JUMP * depth[1:]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return edge


def _supersample(
    baked: Lit, camera: Camera, shared: Bool[np.ndarray, "h w"], centre: np.ndarray, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Mean radiance of the chosen pixels over a rotated grid of rays."""
    rows, columns = np.nonzero(shared)
    k = camera.intrinsics
    turn = camera.pose[:3, :3]
    total = np.zeros_like(centre)
    place = np.arange(EDGE_SAMPLES)
    offsets = np.stack([(place + 0.5) / EDGE_SAMPLES, ((place * 3) % EDGE_SAMPLES + 0.5) / EDGE_SAMPLES], -1)
    for dx, dy in offsets:
        x = (columns + dx - k.cx) / k.fx
        y = (rows + dy - k.cy) / k.fy
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ turn.T
        hits = baked.caster.cast(camera.origin, rays)
        # Bright sky is clipped before it is averaged, as it is on a sensor: else it eats the window's bars.
        light = _diffuse(baked, camera.origin, rays, hits, 1.0 / k.fx, EDGE_LIGHT_SAMPLES)
        total += np.minimum(light, 2.0 / baked.exposure)
    return total / EDGE_SAMPLES


def _mirror(
    baked: Lit, camera: Camera, rays: Float[np.ndarray, "n 3"], hits: Hits, pixel: float
) -> Float[np.ndarray, "h w 3"]:
    """Reflections on varnish, glaze and glass: mirror rays, smeared on the picture by distance and roughness."""
    h, w = camera.intrinsics.shape
    surface = baked.surface
    material = rows(surface.material, hits.face)
    glossy = hits.hit & (rows(baked.textures.gloss, material) > 0)
    nearest, direction = select(hits, glossy), rays[glossy]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = direction / length
    point = camera.origin + direction * (nearest.distance[:, None] * length)
    normal = baked.caster.interpolated_normals(nearest)
    cosine = np.einsum("nk,nk->n", normal, direction)
    normal = np.where(cosine[:, None] > 0, -normal, normal)
    cosine = np.clip(np.abs(cosine), 0, 1)
    # Nothing here is smooth enough to become a full mirror at grazing angles.
    fresnel = np.minimum(0.04 + 0.96 * (1 - cosine) ** 5, 0.5) * baked.textures.gloss[material[glossy]]
    mirrored = direction + 2 * cosine[:, None] * normal
    start = point + 2e-3 * normal
    bounced = baked.caster.cast(start, mirrored)
    away = np.where(bounced.hit, np.minimum(bounced.distance, 6.0), 6.0)
    spread = pixel * (1 + nearest.distance / np.maximum(away, 0.05))
    light = _diffuse(baked, start, mirrored, bounced, spread * 2, 0)
    gone = ~bounced.hit
    light[gone] = baked.mirrored_outside(start[gone], mirrored[gone])
    light = np.minimum(light, 2.5 / baked.exposure)
    # A rough mirror smears far things and leaves those that touch it sharp.
    smear = baked.textures.blur[material[glossy]] * np.clip(away / (away + 0.6 * nearest.distance), 0, 1)
    return _smear(glossy.reshape(h, w), light, fresnel, smear, w / 640)


def _smear(
    where: Bool[np.ndarray, "h w"],
    light: Float[np.ndarray, "n 3"],
    fresnel: Float[np.ndarray, "n"],
    smear: Float[np.ndarray, "n"],
    scale: float,
) -> Float[np.ndarray, "h w 3"]:
    image = np.zeros((*where.shape, 3), np.float32)
    image[where] = light
    weight = where.astype(np.float32)
    layers = [light]
    for sigma in BLURS[1:]:
        s = sigma * scale
        below = gaussian_filter(weight, s, truncate=2.5)[..., None]
        layers.append((gaussian_filter(image, (s, s, 0), truncate=2.5) / np.maximum(below, 1e-6))[where])
    result = layers[0]
    for low, high, layer in zip(BLURS, BLURS[1:], layers[1:]):
        share = np.clip((smear - low) / (high - low), 0, 1)[:, None]
        result = result + (layer - result) * share
    out = np.zeros_like(image)
    out[where] = result * fresnel[:, None]
    return out


def _develop(linear: Float[np.ndarray, "h w 3"], rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Develop exposed linear light to a display-encoded picture in 8-bit steps, by lens, sensor and tone curve."""
    h, w, _ = linear.shape
    scale = w / 640
    sharp = gaussian_filter(linear, (0.42 * scale, 0.42 * scale, 0), truncate=3)
    image = 0.955 * sharp + _glare(linear, scale)
    y, x = np.mgrid[0:h, 0:w]
    radius2 = ((x + 0.5) / w - 0.5) ** 2 + (((y + 0.5) / h - 0.5) * h / w) ** 2
    image *= (1 - 0.45 * radius2)[..., None]
    # Shot noise grows with the root of the light; read noise is the floor under it.
    deviation = np.sqrt(2.5e-5 * np.maximum(image, 0) + 4e-7)
    grain = rng.standard_normal(image.shape, dtype=np.float32)
    image = np.maximum(image + deviation * grain, 0)
    display = encode(tone(image * WHITE_BALANCE))
    # A slight S, as every camera's picture style has.
    display += CONTRAST * (display * display * (3 - 2 * display) - display)
    return (np.round(display * 255) / 255).astype(np.float32)


def _glare(linear: Float[np.ndarray, "h w 3"], scale: float) -> Float[np.ndarray, "h w 3"]:
    """Light scattered in the lens: 2.5 % nearby, 2 % far. Smooth, so it is made at half the size and less."""
    h, w, _ = linear.shape
    half = np.minimum(linear[: h // 2 * 2, : w // 2 * 2], 3.0)
    half = (half[::2, ::2] + half[1::2, ::2] + half[::2, 1::2] + half[1::2, 1::2]) / 4
    near = gaussian_filter(half, (2.5 * scale, 2.5 * scale, 0), truncate=2.5)
    far = gaussian_filter(near[::4, ::4], (3.2 * scale, 3.2 * scale, 0), truncate=3)
    glare = 0.025 * near + 0.02 * resize(far, near.shape, order=1)
    row, column = (np.minimum(np.arange(n) // 2, n // 2 - 1) for n in (h, w))
    return glare[row[:, None], column].astype(np.float32)


def white_level(irradiance: Float[np.ndarray, "t 3"]) -> float:
    """White level: exposure of the room's typical lit surface to middle grey, the same for every frame."""
    typical = np.median(irradiance.mean(axis=1)[irradiance.mean(axis=1) > 1e-4])
    return float(0.36 / typical)
