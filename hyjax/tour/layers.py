"""Layers: light of each lamp by itself, the caches that keep it, and the sums over all lamps."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.data.capture import Frame
from hyjax.geometry.rasterizer import RasterView
from hyjax.guide.choose import FrameGuide
from hyjax.light.emission import SourcePixels
from hyjax.light.kinds import Light
from hyjax.light.photo_light import PhotoLight
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.light.shadow_map import ShadowMap
from hyjax.tour.editable_scene import SceneParts
from hyjax.tour.furniture import Part
from hyjax.util.lru_cache import CachePart, LruCache

KEPT_MIB = 768
"""Memory of all that a renderer keeps."""
CHANNELS = 2
"""Lights are rounded up to a multiple of this, so that another lamp seldom means compiling anew."""
Layer = tuple[Float[Array, "h w"], Float[Array, "h w"]]
"""Illuminance from one light in lux, and its visibility."""


class RenderCancelled(Exception):
    """Raised when a picture is not needed any more."""


class Caches:
    """Caches of frames, shadow maps, light of each lamp, its bounces, and points that they fall on.

    Attributes:
        kept: results of all of them, with one bound.
    """

    def __init__(self) -> None:
        self.kept = LruCache(KEPT_MIB, mebibytes)
        parts = (CachePart(self.kept, kind) for kind in ("frame", "map", "layer", "bounces", "points"))
        self.frames, self.maps, self.layers, self.bounces, self.points = parts


class KeptGuide:
    """Guide whose features of one frame are kept."""

    def __init__(self, guide: FrameGuide, keep: Callable[..., Float[Array, "h w f"]]) -> None:
        self.name, self.fingerprint, self._guide, self._keep = guide.name, guide.fingerprint, guide, keep

    def features(self, display: Float[Array, "h w 3"]) -> Float[Array, "h w f"]:
        """Features, made once."""
        return self._keep(lambda: jax.block_until_ready(self._guide.features(display)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class PhotographedFrame:
    """Light in a frame as it was taken, before the plan moved anything.

    Attributes:
        photo_light: on the surface that the frame shows, relative to its mean; 1 in holes.
        refined: the same after the cascade.
        sources: panes and lamps in it; None if it shows none.
    """

    photo_light: Float[Array, "h w 3"]
    refined: Float[Array, "h w 3"]
    sources: SourcePixels | None


@dataclasses.dataclass(frozen=True, eq=False)
class CancellableCaster:
    """Ray caster of a part of the scene that stops when its picture is not needed any more."""

    part: Part
    bounds: Float[np.ndarray, "2 3"]
    cancelled: Callable[[], bool]

    def distances(self, view: RasterView) -> Float[np.ndarray, "h w"]:
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


def stack_layers(
    layers: Sequence[tuple[Light, Layer]], uniform: Sequence[Light], hit: Bool[Array, "h w"], reference_lux: float
) -> Shaded:
    """Direct light, with channels of no light up to a multiple of `CHANNELS`.

    Args:
        hit: where there is a surface.
    """
    count = -(-len(layers) // CHANNELS) * CHANNELS
    strengths, colors = np.zeros(count, np.float32), np.ones((count, 3), np.float32)
    for k, (light, _) in enumerate(layers):
        strengths[k], colors[k] = getattr(light, light.STRENGTH), light.color
    illuminance, visible = layers[0][1]
    dark = jnp.zeros_like(illuminance), jnp.ones_like(visible)
    padded = (*(layer for _, layer in layers), *[dark] * (count - len(layers)))
    filters = [getattr(own, own.STRENGTH) * np.asarray(own.color) / reference_lux for own in uniform]
    ambient = np.sum(filters, axis=0, dtype=np.float32) if filters else np.ones(3, np.float32)
    return _stack(padded, strengths, colors, hit, np.float32(reference_lux), ambient)


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


def add_bounces(
    bounced: Sequence[tuple[Light, Float[Array, "v 3"]]], least: Float[Array, "3"], points: int
) -> Float[Array, "v 3"]:
    """Bounces of all lights.

    Args:
        bounced: lights, each with its own if it were white and of strength 1.
        least: illuminance that they are filled up to.
    """
    total = jnp.zeros((points, 3))
    for light, own in bounced:
        total += getattr(light, light.STRENGTH) * np.asarray(light.color, np.float32) * own
    return jnp.maximum(total, least)


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


@jax.jit
def lit_surface(
    shaded: Shaded, albedo: Float[ArrayLike, "*a"], reference_lux: Float[ArrayLike, ""]
) -> Float[Array, "h w 3"]:
    """Linear picture of a surface by its albedo; black where there is none."""
    lux = mix_channels(shaded.illuminance * shaded.visibility, shaded.colors)
    if shaded.bounced is not None:
        lux += shaded.bounced
    return jnp.where(shaded.confidence > 0, albedo * lux / reference_lux, 0.0)
