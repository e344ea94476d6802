"""Light in a room beside what comes straight from new lights: bounces, and what is left of the photo's own light.

Bounces are linear in each light: those of a white light of strength 1 are kept, and scaled and added live.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.light.kinds import Light
from hyjax.light.photo_light import PhotoLight, SurfaceLight
from hyjax.light.setup import LightSetup
from hyjax.photo_light.sources import PhotoSources
from hyjax.scene.photo_light import ScenePhotoLight
from hyjax.tour.editable_scene import SceneParts
from hyjax.tour.layers import LayerCache, Quality
from hyjax.tour.picture import CHANNELS
from hyjax.util.errors import did_you_mean
from hyjax.util.lru_cache import LruCache

ARRANGEMENTS = 4
"""Of furniture, whose points are kept."""


class RoomLight:
    """Photo's own light of a scene, and bounces in it, as a tour needs them.

    Args:
        photo: estimated now, if it was not before.
        layers: keeps the shadow maps and bounces of each light.

    Raises:
        InputError: the file that names the photo's sources cannot be used.
    """

    def __init__(self, photo: ScenePhotoLight, layers: LayerCache) -> None:
        self._photo, self._layers, self._points = photo, layers, LruCache(ARRANGEMENTS)
        self._light = photo.estimate.light

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the photo's sources."""
        return self._photo.estimate.names

    @property
    def sources(self) -> PhotoSources:
        """Windows and lamps among them."""
        return self._photo.sources

    @property
    def doubt(self) -> str | None:
        """Why the photo's light stays in the pictures; None if it is divided out."""
        return self._photo.estimate.reason if self._photo.estimate.exponent == 0 else None

    def unknown(self, existing: Mapping[str, float]) -> str | None:
        """Which names are no source of these photos, in words; None if all are."""
        wrong = [f"{name!r}{did_you_mean(name, self.names)}" for name in existing if name not in self.names]
        return f"the photos have no source {', '.join(wrong)}; there are {', '.join(self.names)}" if wrong else None

    def surface_light(
        self,
        setup: LightSetup,
        qualities: Sequence[Quality],
        parts: SceneParts,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> SurfaceLight:
        """Light on the vertices of the scan.

        Args:
            setup: new lights, and what is left of the photo's sources.
            qualities: of the shadow maps of each light.
            parts: of the scene.
            cancelled: see `LayerCache.shade`.

        Raises:
            InputError: there is no source of a name.
            RenderCancelled: `cancelled` returned true.
        """
        kept = np.asarray(self._photo.kept(setup.existing), np.float32)
        chosen = [
            (light, self._layers.bounced(light, lambda: self._arranged(parts), parts, quality, cancelled))
            for light, quality in zip(setup.lights, qualities, strict=True)
            if not light.UNIFORM
        ]
        count = -(-max(len(chosen), 1) // CHANNELS) * CHANNELS
        scales = np.zeros((count, 3), np.float32)
        for k, (light, _) in enumerate(chosen):
            scales[k] = getattr(light, light.STRENGTH) * np.asarray(light.color)
        dark = jnp.zeros_like(self._light.illuminance)
        padded = (*(bounced for _, bounced in chosen), *[dark] * (count - len(chosen)))
        bounced = _add_up(padded, scales, self._light.sources, np.float32(setup.reference_lux) * kept)
        emitters = self._photo.emitters(setup)
        return SurfaceLight(self._light.illuminance, bounced, self._light.transport.faces, emitters)

    def _arranged(self, parts: SceneParts) -> PhotoLight:
        """Photo's light with the transport's points where the furniture is now; what they see stays as scanned."""
        if not any(part.moved and part.scanned is not None for part in parts.parts):
            return self._light
        return self._points(parts.keys, lambda: _move_points(self._light, parts))


def bounced_at_vertices(light: SurfaceLight, parts: SceneParts) -> Float[Array, "v 3"]:
    """Bounces at the vertices of the parts, one after the other; the mean on what was brought in."""
    bounced, each = np.asarray(light.bounced), []
    for part in parts.parts:
        numbers = part.scanned_vertices
        mean = np.broadcast_to(bounced.mean(axis=0), (len(part.caster.mesh.vertices), 3))
        each.append(mean if numbers is None else bounced[numbers])
    return jnp.asarray(np.concatenate(each))


def direct_lights(lights: Sequence[Light]) -> tuple[Light, ...]:
    """Lights in whose place no bounces stand: those that do not fall on any surface alike, or all if none are."""
    return tuple(light for light in lights if not light.UNIFORM) or tuple(lights)


@jax.jit
def _add_up(
    bounces: tuple[Float[Array, "v 3"], ...],
    scales: Float[Array, "l 3"],
    sources: Float[Array, "s v 3"],
    kept: Float[Array, "s 3"],
) -> Float[Array, "v 3"]:
    total = jnp.einsum("sc,svc->vc", kept, sources)
    for k, bounced in enumerate(bounces):
        total += scales[k] * bounced
    return total


def _move_points(light: PhotoLight, parts: SceneParts) -> PhotoLight:
    position, normal = (np.array(x) for x in (light.transport.position, light.transport.normal))
    for part in parts.parts:
        numbers = part.scanned_vertices
        if part.moved and numbers is not None:
            turn, shift = part.pose[:3, :3], part.pose[:3, 3]
            position[numbers] = position[numbers] @ turn.T + shift
            normal[numbers] = normal[numbers] @ turn.T
    points = {"position": jnp.asarray(position), "normal": jnp.asarray(normal)}
    return dataclasses.replace(light, transport=dataclasses.replace(light.transport, **points))
