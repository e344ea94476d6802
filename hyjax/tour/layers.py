"""Layers: illuminance and visibility of each light by itself, cached together with its shadow maps.

Brightness and colour of a light change no layer; a light that moves changes its own alone. A piece of furniture
that moves is cast anew by itself, and its shadow maps join those of the room by their minimum.
"""

import dataclasses
import functools
from collections.abc import Callable, Hashable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.data.capture import Frame
from hyjax.geometry.rasterizer import RasterView
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import PhotoLight, bounced_light
from hyjax.light.setup import geometry_key
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import ShadowMap, visibility
from hyjax.tour.editable_scene import SceneParts
from hyjax.tour.furniture import Part
from hyjax.tour.picture import Layer
from hyjax.util.lru_cache import LruCache
from hyjax.util.programs import run_kept

DRAFT = 0.5
"""Resolution of shadow maps while something is being dragged, relative to that of `hyjax relight`."""
DRAFT_VIEWS = 4
"""Most views in a draft's shadow map of a light without a radius, such as a window."""
MAPS_MIB, LAYERS_MIB, BOUNCES_MIB = 512, 192, 96
Quality = Literal["draft", "fine"]


class RenderCancelled(Exception):
    """Raised when a picture is not needed any more."""


class LayerCache:
    """Layers and shadow maps that were made lately."""

    def __init__(self) -> None:
        self._maps, self._layers = LruCache(MAPS_MIB, mebibytes), LruCache(LAYERS_MIB, mebibytes)
        self._bounces = LruCache(BOUNCES_MIB, mebibytes)

    def layer(
        self,
        light: Light,
        frame: int,
        samples: GBuffer,
        parts: SceneParts,
        quality: Quality,
        cancelled: Callable[[], bool],
        *,
        sampling: int,
    ) -> Layer:
        """`shade` samples of a frame, from the cache if they are there."""
        key = quality, geometry_key(light), frame, parts.keys, sampling
        return self._layers(key, lambda: self.shade(light, samples, parts, quality, cancelled))

    def is_fine(self, light: Light, frame: int, parts: SceneParts, *, sampling: int) -> bool:
        """Whether a light in a frame needs no shadow map to be cast for quality `fine`."""
        key = "fine", geometry_key(light), frame, parts.keys, sampling
        return key in self._layers or self.has_maps(light, parts)

    def has_maps(self, light: Light, parts: SceneParts) -> bool:
        """Whether a light's fine shadow maps are there."""
        if light.UNIFORM:
            return True
        geometry = geometry_key(light)
        return all((geometry, key, "fine") in self._maps for key in parts.keys)

    def shade(
        self,
        light: Light,
        gbuffer: GBuffer,
        parts: SceneParts,
        quality: Quality,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Layer:
        """Illuminance of a light of strength 1, and its visibility.

        Args:
            light: of any strength and colour.
            gbuffer: surface points to shade.
            parts: of the scene; they cast the shadows.
            quality: of the shadow maps.
            cancelled: asked before each view of a shadow map that must be cast.

        Raises:
            RenderCancelled: `cancelled` returned true.
        """
        unit, shadow_map = light.normalized(), self._shadow_map(light, parts, quality, cancelled)
        return run_kept(shade_each, gbuffer, [unit])[..., 0], run_kept(visibility, gbuffer, unit, shadow_map)

    def bounced(
        self,
        light: Light,
        points: Callable[[], PhotoLight],
        parts: SceneParts,
        quality: Quality,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Float[Array, "v 3"]:
        """Lux that a white light of strength 1 throws on the scan's vertices by way of other surfaces.

        A draft leaves it as it was while furniture moves.

        Args:
            light: of any strength and colour.
            points: makes the scan's transport, with its points where the furniture is.
            parts, quality, cancelled: see `shade`.

        Raises:
            RenderCancelled: `cancelled` returned true.
        """
        geometry, unit = geometry_key(light), light.normalized()
        fine, draft = (geometry, parts.keys), geometry

        def make() -> Float[Array, "v 3"]:
            shadow_map = self._shadow_map(light, parts, quality, cancelled)
            return jax.block_until_ready(run_kept(bounced_light, points(), [unit], [shadow_map]))

        return self._bounces(fine if quality == "fine" or fine in self._bounces else draft, make)

    def _shadow_map(
        self, light: Light, parts: SceneParts, quality: Quality, cancelled: Callable[[], bool]
    ) -> ShadowMap | None:
        """Shadow map that all parts cast together."""
        geometry, unit, scale, most = geometry_key(light), light.normalized(), 1.0, None
        if quality == "draft":
            unit, scale, most = without_radius(unit), DRAFT, DRAFT_VIEWS

        def cast(part: Part, key: Hashable) -> ShadowMap | None:
            caster: Any = CancellableCaster(part.draft if quality == "draft" else part, cancelled)
            return self._maps(
                (geometry, key, quality), lambda: cast_shadow_maps(caster, [unit], scale, part.slack, most)[0]
            )

        return _merge_maps([cast(part, key) for part, key in zip(parts.parts, parts.keys, strict=True)])


@dataclasses.dataclass(frozen=True, eq=False)
class CancellableCaster:
    """Ray caster of a part of the scene that stops when its picture is not needed any more."""

    part: Part
    cancelled: Callable[[], bool]

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        return np.asarray(self.part.mesh.bounds)

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


def _merge_maps(maps: list[ShadowMap | None]) -> ShadowMap | None:
    """The shadow map of several parts: the depth of the part nearest to the light."""
    first, *others = maps
    if first is None:
        return None
    depth = functools.reduce(jnp.minimum, [m.depth for m in others if m is not None], first.depth)
    return dataclasses.replace(first, depth=depth)
