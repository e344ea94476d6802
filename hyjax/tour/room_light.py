"""Indirect light in a room: bounces, and the rest of the photo's own light.

Bounces are linear in each light: those of a white light of strength 1 are kept, and scaled and added live.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.configuration import Configuration
from hyjax.core.refine import cascade_known
from hyjax.core.schedule import Schedule
from hyjax.geometry.camera import Camera
from hyjax.light.emission import SourcePixels, shine, source_pixels
from hyjax.light.gbuffer import GBuffer, sample_pixels
from hyjax.light.kinds import Light
from hyjax.light.photo_light import PhotoLight, SurfaceLight, on_pixels
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.photo_light.sources import PhotoSources
from hyjax.scene.photo_light import ScenePhotoLight
from hyjax.scene.relighter import configured_light
from hyjax.tour.editable_scene import SceneParts
from hyjax.tour.layers import LayerCache, Quality
from hyjax.tour.picture import CHANNELS
from hyjax.util.lru_cache import LruCache
from hyjax.util.programs import run_kept

ARRANGEMENTS = 4
"""Arrangements of furniture whose points are kept."""
DRAFT_RAYS = 64
"""Rays of each point, while something is being dragged."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class PhotographedFrame:
    """Light in a frame as it was taken.

    Attributes:
        photo_light: on samples of the surface that the frame shows, relative to its mean; 1 in holes.
        known: 1 where there is a surface.
        sources: panes and lamps in it; None if the room has none.
        sampling: see `Shaded` (static).
    """

    photo_light: Float[Array, "sh sw 3"]
    known: Float[Array, "sh sw 1"]
    sources: SourcePixels | None
    sampling: int = dataclasses.field(metadata={"static": True})

    def refined(self, guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w 3"]:
        """The photo's light after the cascade."""
        return run_kept(cascade_known, self.photo_light, self.known, guide, schedule, sampling=self.sampling)


class RoomLight:
    """Photo's own light of a scene, and bounces in it, as a tour needs them.

    Args:
        photo: estimated now, if it was not before.
        layers: keeps the shadow maps and bounces of each light.
        configuration: its choices of the light on the surface are followed.
    """

    def __init__(
        self, photo: ScenePhotoLight, layers: LayerCache, configuration: Configuration | None = None
    ) -> None:
        self._photo, self._layers, self._points = photo, layers, LruCache(ARRANGEMENTS)
        self._configuration, self._light = configuration or Configuration(), photo.estimate.light
        transport = self._light.transport
        step = max(1, len(transport.hits) // DRAFT_RAYS)
        self._draft = dataclasses.replace(
            self._light, transport=dataclasses.replace(transport, hits=transport.hits[::step])
        )

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

    @property
    def filled_share(self) -> float:
        """Share of ambient light that bounces are filled up to."""
        return self._light.filled_share

    def unknown(self, existing: Mapping[str, float]) -> str | None:
        """Which names are no source of these photos, in words; None if all are."""
        return self._photo.unknown(existing)

    def surface_light(
        self,
        setup: LightSetup,
        qualities: Sequence[Quality],
        parts: SceneParts,
        least: Float[Array, "3"],
        cancelled: Callable[[], bool] = lambda: False,
    ) -> SurfaceLight:
        """Light on the vertices of the scan.

        Args:
            setup: new lights, and what is left of the photo's sources.
            qualities: of the shadow maps of each light.
            parts: of the scene.
            least: illuminance that bounces are filled up to.
            cancelled: see `LayerCache.shade`.

        Raises:
            InputError: there is no source of a name.
            RenderCancelled: `cancelled` returned true.
        """
        kept = np.asarray(self._photo.kept(setup.existing), np.float32)
        chosen = [
            (light, self._layers.bounced(light, self._points_of(parts, quality), parts, quality, cancelled))
            for light, quality in zip(setup.lights, qualities, strict=True)
            if not light.UNIFORM
        ]
        count = -(-max(len(chosen), 1) // CHANNELS) * CHANNELS
        scales = np.zeros((count, 3), np.float32)
        for k, (light, _) in enumerate(chosen):
            scales[k] = getattr(light, light.STRENGTH) * np.asarray(light.color)
        dark = jnp.zeros_like(self._light.illuminance)
        padded = (*(bounced for _, bounced in chosen), *[dark] * (count - len(chosen)))
        bounced = _add_up(padded, scales, self._light.sources, np.float32(setup.reference_lux) * kept, least)
        whole = SurfaceLight(
            self._light.illuminance, bounced, self._light.transport.faces, self._photo.emitters(setup)
        )
        whole = configured_light(whole, self._configuration)
        return whole if whole.bounced is not None else dataclasses.replace(whole, bounced=dark)

    def photographed(
        self, camera: Camera, frame: Float[Array, "h w 3"], gbuffer: GBuffer, *, sampling: int = 1
    ) -> PhotographedFrame:
        """Light in a frame as it was taken.

        Args:
            camera: of the frame.
            frame: linear.
            gbuffer: the room as it was scanned.
            sampling: see `PhotographedFrame`.
        """
        light, samples = self._light, sample_pixels(gbuffer, sampling=sampling)
        hit = samples.hit[..., None]
        own = configured_light(SurfaceLight(light.illuminance, None, light.transport.faces), self._configuration)
        photo_light = jnp.where(hit, on_pixels(own.photo_light, own.faces, samples), 1.0)
        emitters, sources = self._photo.emitters(LightSetup(())), None
        if emitters is not None:
            pose, matrix = (jnp.asarray(m, jnp.float32) for m in (camera.pose, camera.intrinsics.matrix))
            sources = source_pixels(emitters, frame, gbuffer, pose, matrix)
        return jax.block_until_ready(PhotographedFrame(photo_light, hit.astype(jnp.float32), sources, sampling))

    def _points_of(self, parts: SceneParts, quality: Quality) -> Callable[[], PhotoLight]:
        """Maker of the transport with its points where the furniture is now; their surroundings stay as scanned."""

        def make() -> PhotoLight:
            light = self._light if quality == "fine" else self._draft
            moved = any(part.moved and part.scanned is not None for part in parts.parts)
            return _move_points(light, parts) if moved else light

        return lambda: self._points((parts.keys, quality), make)


def bounced_at_vertices(light: SurfaceLight, parts: SceneParts) -> Float[Array, "v 3"]:
    """Bounces at the vertices of the parts, one after the other; the mean on uploaded pieces."""
    bounced, each = np.asarray(light.bounced), []
    for part in parts.parts:
        numbers = part.scanned_vertices
        mean = np.broadcast_to(bounced.mean(axis=0), (len(part.caster.mesh.vertices), 3))
        each.append(mean if numbers is None else bounced[numbers])
    return jnp.asarray(np.concatenate(each))


def direct_lights(lights: Sequence[Light]) -> tuple[Light, ...]:
    """Lights in whose place no bounces stand: those that do not fall on any surface alike, or all if none are."""
    return tuple(light for light in lights if not light.UNIFORM) or tuple(lights)


def add_room_light(
    shaded: Shaded,
    light: SurfaceLight,
    photographed: PhotographedFrame,
    frame: Float[Array, "h w 3"],
    samples: GBuffer,
) -> Shaded:
    """Shaded surface with bounces, with the photo's own light, and with emitters.

    Args:
        shaded: direct light.
        light: on the vertices.
        photographed, frame: the photo, which shows furniture where it was.
        samples: of the room as it is now, as many as were shaded.
    """
    shining = None
    if light.emitters is not None and photographed.sources is not None:
        shining = shine(light.emitters, photographed.sources, frame)
    bounced = on_pixels(light.bounced, light.faces, samples)
    return dataclasses.replace(shaded, bounced=bounced, photo_light=photographed.photo_light, emission=shining)


@jax.jit
def _add_up(
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


def _move_points(light: PhotoLight, parts: SceneParts) -> PhotoLight:
    position, normal = (np.array(x) for x in (light.transport.position, light.transport.normal))
    for part in parts.parts:
        numbers = part.scanned_vertices
        if part.moved and numbers is not None:
            turn, shift = part.pose[:3, :3], part.pose[:3, 3]
            position[numbers] = position[numbers] @ turn.T + shift
            normal[numbers] = normal[numbers] @ turn.T
    transport = dataclasses.replace(light.transport, position=jnp.asarray(position), normal=jnp.asarray(normal))
    return dataclasses.replace(light, transport=transport)
