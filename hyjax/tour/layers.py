"""Layers: light of each lamp by itself, the caches that keep it, and the sums over all lamps."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hyjax.data.capture import Frame
from hyjax.geometry.rasterizer import RasterView
from hyjax.guide.choose import FrameGuide
from hyjax.light.kinds import Light
from hyjax.light.photo_light import PhotoLight
from hyjax.light.shaded import Shaded
from hyjax.light.shadow_map import ShadowMap
from hyjax.tour.editable_scene import SceneParts
from hyjax.tour.furniture import Part
from hyjax.util.lru_cache import LruCache

FRAMES_MIB, MAPS_MIB, LAYERS_MIB, BOUNCES_MIB = 128, 512, 192, 96
ARRANGEMENTS = 4
"""Arrangements of furniture whose points are kept."""
CHANNELS = 2
"""Lights are rounded up to a multiple of this, so that another lamp seldom means compiling anew."""
Layer = tuple[Float[Array, "h w"], Float[Array, "h w"]]
"""Illuminance from one light in lux, and its visibility."""


class RenderCancelled(Exception):
    """Raised when a picture is not needed any more."""


class Caches:
    """Caches of frames, shadow maps, light of each lamp, its bounces, and points that they fall on."""

    def __init__(self) -> None:
        self.frames, self.maps, self.layers, self.bounces = (
            LruCache(size, mebibytes) for size in (FRAMES_MIB, MAPS_MIB, LAYERS_MIB, BOUNCES_MIB)
        )
        self.points = LruCache(ARRANGEMENTS)


@dataclasses.dataclass(frozen=True)
class KeptGuide:
    """Guide whose features of one frame are kept."""

    guide: FrameGuide
    keep: Callable[[Callable[[], Float[Array, "h w f"]]], Float[Array, "h w f"]]

    @property
    def name(self) -> str:
        """See `FrameGuide`."""
        return self.guide.name

    @property
    def fingerprint(self) -> str:
        """See `FrameGuide`."""
        return self.guide.fingerprint

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features, made once."""
        return self.keep(lambda: jax.block_until_ready(self.guide.features(display)))


@dataclasses.dataclass(frozen=True, eq=False)
class CancellableCaster:
    """Ray caster of a part of the scene that stops when its picture is not needed any more."""

    part: Part
    bounds: Float[np.ndarray, "2 3"]
    cancelled: Callable[[], bool]

    def distances(self, view: RasterView) -> Float[np.ndarray, "h w"]:
        """See `RayCaster`."""
        if self.cancelled():
            raise RenderCancelled
        return self.part.distances(view)


def mebibytes(result: object) -> float:
    """Memory of arrays, or of the picture of a frame; an array that occurs twice counts once."""
    arrays = {id(leaf): leaf for leaf in jax.tree.leaves(result.image if isinstance(result, Frame) else result)}
    return sum(getattr(array, "nbytes", 0) for array in arrays.values()) / 2**20


def without_radius(light: Light) -> Light:
    """The light, with hard shadows if it is a lamp or a sun with a radius: one view in the place of many."""
    none = {name: np.asarray(0.0, np.float32) for name in ("radius", "angular_radius") if hasattr(light, name)}
    return dataclasses.replace(light, **none)  # type: ignore[type-var]


def round_up(count: int) -> int:
    """Count rounded up to a multiple of `CHANNELS`."""
    return -(-count // CHANNELS) * CHANNELS


def stack_layers(
    lights: Sequence[Light],
    layers: Sequence[Layer],
    hit: Bool[Array, "h w"],
    reference_lux: float,
    ambient: Float[np.ndarray, "3"],
) -> Shaded:
    """Direct light, with channels of no light up to a multiple of `CHANNELS`."""
    count = round_up(len(layers))
    strengths, colors = np.zeros(count, np.float32), np.ones((count, 3), np.float32)
    for k, light in enumerate(lights):
        strengths[k], colors[k] = getattr(light, light.STRENGTH), light.color
    illuminance, visible = layers[0]
    dark = jnp.zeros_like(illuminance), jnp.ones_like(visible)
    padded = (*layers, *[dark] * (count - len(layers)))
    return _stack(padded, strengths, colors, hit, np.float32(reference_lux), np.asarray(ambient, np.float32))


@jax.jit
def _stack(
    layers: tuple[Layer, ...],
    strengths: Float[Array, "l"],
    colors: Float[Array, "l 3"],
    hit: Bool[Array, "h w"],
    reference_lux: Float[Array, ""],
    ambient: Float[Array, "3"],
) -> Shaded:
    illuminance = jnp.stack([lux for lux, _ in layers], axis=-1) * strengths
    visible = jnp.stack([visible for _, visible in layers], axis=-1)
    return Shaded(illuminance, visible, colors, hit[..., None].astype(jnp.float32), reference_lux, ambient)


@jax.jit
def add_bounces(
    bounces: tuple[Float[Array, "v 3"], ...],
    scales: Float[Array, "l 3"],
    sources: Float[Array, "s v 3"],
    kept: Float[Array, "s 3"],
    least: Float[Array, "3"],
) -> Float[Array, "v 3"]:
    total = jnp.zeros_like(bounces[0])
    for k, bounced in enumerate(bounces):
        total += scales[k] * bounced
    return jnp.maximum(total, least) + jnp.einsum("sc,svc->vc", kept, sources)


def merge_maps(maps: list[ShadowMap | None]) -> ShadowMap | None:
    """The shadow map of several parts: the depth of the part nearest to the light."""
    first, *others = maps
    if first is None:
        return None
    depth = functools.reduce(jnp.minimum, [m.depth for m in others if m is not None], first.depth)
    return dataclasses.replace(first, depth=depth)


def move_points(light: PhotoLight, parts: SceneParts) -> PhotoLight:
    position, normal = (np.array(x) for x in (light.transport.position, light.transport.normal))
    for part in parts.parts:
        numbers = part.scanned_vertices
        if part.moved and numbers is not None:
            turn, shift = part.pose[:3, :3], part.pose[:3, 3]
            position[numbers] = position[numbers] @ turn.T + shift
            normal[numbers] = normal[numbers] @ turn.T
    transport = dataclasses.replace(light.transport, position=jnp.asarray(position), normal=jnp.asarray(normal))
    return dataclasses.replace(light, transport=transport)
