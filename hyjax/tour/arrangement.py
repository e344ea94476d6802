"""Arrangement: a place as a plan furnishes it, and the light of each lamp in it by itself, from caches.

Brightness and colour of a light change none of what is cached; a light that moves changes its own alone. A piece
of furniture that moves is cast anew by itself, and its shadow maps join those of the room by their minimum. Bounces
are linear in each light: those of a white light of strength 1 are kept, and scaled and added live.
"""

import copy
import dataclasses
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.configuration import Configuration
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.guide.choose import FrameGuide
from hyjax.light.emission import shine, source_pixels
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import (
    PhotoLight,
    SurfaceLight,
    bounced_by,
    direct_channels,
    indirect_on_pixels,
    least_bounced,
    on_pixels,
)
from hyjax.light.setup import LightSetup, geometry_key
from hyjax.light.shaded import Shaded
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import ShadowMap, visibility
from hyjax.light.view import View
from hyjax.pipeline import refine_illuminance, refine_visibility
from hyjax.scene.photo_light import ScenePhotoLight
from hyjax.scene.relighter import casters, view_features
from hyjax.tour.editable_scene import EditableScene, SceneParts
from hyjax.tour.furniture import Part, merge_gbuffers
from hyjax.tour.layers import (
    Caches,
    CancellableCaster,
    Layer,
    PhotographedFrame,
    add_bounces,
    merge_maps,
    move_points,
    stack_layers,
    without_radius,
)
from hyjax.tour.plan import TourPlan
from hyjax.util.programs import run_kept

DRAFT_SCALE = 0.5
"""Resolution of shadow maps while something is being dragged, relative to that of `hyjax relight`."""
DRAFT_VIEWS = 4
"""Most views in a draft's shadow map of a light without a radius, such as a window."""
DRAFT_RAYS = 64
"""Rays of each point that light bounces by, while something is being dragged."""


class Arrangement:
    """Place as a plan furnishes it; the light in it comes from caches.

    Attributes:
        coarse: whether shadows of a light were coarse.
        configuration: that it is lit by.

    Args:
        caches: shared by the pictures of a tour.
        photo: the photo's own light; None if that stays in the pictures.
        draft: whether coarse shadow maps will do for lights that have just moved.
        cancelled: asked before each view of a shadow map that must be cast; if true, `RenderCancelled` is raised.
    """

    def __init__(
        self,
        scene: EditableScene,
        plan: TourPlan,
        caches: Caches,
        photo: ScenePhotoLight | None,
        configuration: Configuration,
        *,
        draft: bool = False,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self.parts, self.coarse = scene.apply(plan), False
        self._visible: tuple[Hashable, ...] = ()  # key of the visibility of what was shaded last
        self._scene, self._caches, self._photo, self.configuration = scene, caches, photo, configuration
        self._draft, self._cancelled, shadows = draft, cancelled, configuration.shadows
        self._map_size = shadows.map_scale, shadows.views

    def smaller(self, factor: int) -> "Arrangement":
        """The same, lit at a part of the frames' size."""
        other = copy.copy(self)
        other.configuration = dataclasses.replace(self.configuration, scale=factor * self.configuration.scale)
        return other

    @property
    def scale(self) -> int:
        """Factor by which frames are smaller when they are relit."""
        return self.configuration.sampled().scale

    # ---- a place ----

    @property
    def revision(self) -> int:
        """Number of the surface."""
        return self._scene.revision

    @property
    def knows_photo_light(self) -> bool:
        """Whether the light that the frames were taken under can be divided out."""
        return self._photo is not None

    @property
    def caster(self) -> RayCaster:
        """The surface as it was scanned."""
        return self._scene.caster

    def frame(self, index: int | Frame) -> Frame:
        """A frame as it is."""
        assert isinstance(index, Frame)
        return index

    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface points of all parts that a camera sees."""
        return self._seen(camera, self.parts)

    def scanned(self, camera: Camera) -> GBuffer:
        """Surface points that a camera saw before the plan moved anything."""
        return self._seen(camera, self._scene.apply(TourPlan()))

    def lights(self, lights: LightSetup | Sequence[Light] | str | Path, **_: Any) -> LightSetup:
        """A set-up as it is."""
        assert not isinstance(lights, str | Path)
        return LightSetup.of(lights)

    def shadow_maps(
        self, lights: LightSetup | Sequence[Light], *, scale: float = 1.0, most_views: int | None = None, **_: Any
    ) -> tuple[ShadowMap | None, ...]:
        """Shadow maps of lights that all parts throw; coarse ones in a draft, where there are no fine ones yet."""
        usable, size = LightSetup.of(lights).lights, (scale, most_views)
        return tuple(self._shadow_map(light, size, self.is_coarse(light, *size)) for light in usable)

    def surface_light(self, lights: LightSetup | Sequence[Light], **_: Any) -> SurfaceLight:
        """Photo's own light and the bounces of new lights, on the scan's vertices."""
        assert self._photo is not None
        setup, light = LightSetup.of(lights), self._photo.estimate.light
        bounced = [(lamp, self._bounced(lamp)) for lamp in setup.lights if not lamp.UNIFORM]
        least = least_bounced(setup.lights, light.filled_share)
        return self._photo.with_sources(add_bounces(bounced, least, len(light.illuminance)), setup)

    # ---- light on a view ----

    def shade(
        self,
        frame: int,
        guide: FrameGuide,
        setup: LightSetup,
        view: View,
        camera: Camera,
        light: SurfaceLight | None,
    ) -> tuple[View, Shaded]:
        """Light on a frame; with the first arguments given, a `Shader`."""
        key = self._key(frame)
        shaded = self.shade_surface(view.gbuffer, setup, light, key)
        if light is None:
            return view, shaded
        kept = "photographed", key, self.configuration.schedule.to_json()
        photographed = self._caches.frames(kept, lambda: self._photographed(view, camera, light, guide))
        emission = None
        if light.emitters is not None and photographed.sources is not None:
            emission = shine(light.emitters, photographed.sources, view.source_frame(run=run_kept))
        photo_light, refined = photographed.photo_light, photographed.refined
        return view, dataclasses.replace(
            shaded, photo_light=photo_light, refined_photo_light=refined, emission=emission
        )

    def shade_surface(
        self, surface: GBuffer, setup: LightSetup, light: SurfaceLight | None, key: Hashable = None
    ) -> Shaded:
        """Direct and bounced light on surface points."""
        bounces = light is not None and light.bounced is not None
        uniform = [lamp for lamp in setup.lights if lamp.UNIFORM]
        casting = casters(self, setup.lights, self.configuration.shadows.least_share)
        direct = direct_channels(setup.lights, bounces)
        lit = [setup.lights[place] for place in direct]
        made = [self._layer(setup.lights[place], surface, key, casting[place]) for place in direct]
        if key is not None:
            shining = (float(getattr(lamp, lamp.STRENGTH)) > 0 for lamp in lit)
            self._visible = *(name for name, _ in made), *shining
        layers = [(lamp, layer) for lamp, (_, layer) in zip(lit, made, strict=True)]
        shaded = stack_layers(layers, uniform, surface.hit, setup.reference_lux)
        indirect = None if light is None else indirect_on_pixels(light, surface)
        return dataclasses.replace(shaded, bounced=indirect)

    def run(self, function: Callable[..., Any], *arrays: Any, **static: Any) -> Any:
        """Result of a stage of the refinement; brightness and colour leave that of the shadow pass as it was."""
        if function is not refine_visibility or self.coarse:
            return run_kept(function, *arrays, **static)
        *_, schedule = arrays
        key = "visible", self._visible, schedule.to_json()
        return self._caches.frames(key, lambda: jax.block_until_ready(run_kept(function, *arrays, **static)))

    def is_coarse(self, light: Light, scale: float = 1.0, most_views: int | None = None) -> bool:
        """Whether a draft takes coarse shadow maps of a light, as there are no fine ones yet."""
        if not self._draft or light.UNIFORM:
            return False
        geometry = geometry_key(light)
        return not all((geometry, key, scale, most_views, False) in self._caches.maps for key in self.parts.keys)

    def any_coarse(self, setup: LightSetup, frame: int) -> bool:
        """Whether a draft of a frame takes coarse shadow maps of any light, as its fine light is not kept."""
        key = self._key(frame)

        def is_kept(light: Light) -> bool:
            names = ((geometry_key(light), key, self.parts.keys, casts) for casts in (True, False))
            return any((name, False) in self._caches.layers for name in names)

        return any(self.is_coarse(light, *self._map_size) and not is_kept(light) for light in setup.lights)

    def _key(self, frame: int) -> Hashable:
        """Key of light on a frame's surface."""
        return frame, self.configuration.interleave, self.scale

    def _layer(self, light: Light, surface: GBuffer, key: Hashable, casts: bool) -> tuple[Hashable, Layer]:
        """Illuminance of a light of strength 1, and its visibility, with their key.

        Without a key nothing is kept, and each pixel has all of a soft shadow: no cascade joins it with others.
        """
        size, interleave = self._map_size, 1 if key is None else self.configuration.interleave
        name = geometry_key(light), key, self.parts.keys, casts
        coarse = casts and (name, False) not in self._caches.layers and self.is_coarse(light, *size)
        self.coarse |= coarse

        def make() -> Layer:
            unit, shadow_map = light.normalized(), self._shadow_map(light, size, coarse) if casts else None
            lux = run_kept(shade_each, surface, [unit])[..., 0]
            return jax.block_until_ready(
                (lux, run_kept(visibility, surface, unit, shadow_map, interleave=interleave))
            )

        return (name, coarse), make() if key is None else self._caches.layers((name, coarse), make)

    def _shadow_map(self, light: Light, size: tuple[float, int | None], coarse: bool) -> ShadowMap | None:
        """Shadow map that all parts cast together."""
        geometry, unit, (scale, most) = geometry_key(light), light.normalized(), size
        if coarse:
            unit, scale = without_radius(unit), DRAFT_SCALE * scale
            most = DRAFT_VIEWS if most is None else min(most, DRAFT_VIEWS)

        def cast(part: Part, key: Hashable) -> ShadowMap | None:
            caster_of_part = part.draft if coarse else part
            caster: Any = CancellableCaster(caster_of_part, self._scene.bounds, self._cancelled)
            return self._caches.maps(
                (geometry, key, *size, coarse), lambda: cast_shadow_maps(caster, [unit], scale, part.slack, most)[0]
            )

        return merge_maps([cast(part, key) for part, key in zip(self.parts.parts, self.parts.keys, strict=True)])

    def _bounced(self, light: Light) -> Float[Array, "v 3"]:
        """Lux that a white light of strength 1 throws on the scan's vertices by way of other surfaces.

        A draft leaves it as it was while furniture moves.
        """
        geometry, unit = geometry_key(light), light.normalized()
        fine = geometry, self.parts.keys
        coarse = fine not in self._caches.bounces and self.is_coarse(light)
        self.coarse |= coarse

        def make() -> Float[Array, "v 3"]:
            points, shadow_map = self._points(coarse), self._shadow_map(light, (1.0, None), coarse)
            return jax.block_until_ready(bounced_by(points, unit, shadow_map, run=run_kept))

        return self._caches.bounces(geometry if coarse else fine, make)

    def _points(self, coarse: bool) -> PhotoLight:
        """Transport with its points where the furniture is now; their surroundings stay as scanned."""
        assert self._photo is not None
        light = self._photo.estimate.light
        moved = any(part.moved and part.scanned is not None for part in self.parts.parts)

        def make() -> PhotoLight:
            made = light
            if coarse:
                hits = light.transport.hits
                fewer = dataclasses.replace(light.transport, hits=hits[:: max(1, len(hits) // DRAFT_RAYS)])
                made = dataclasses.replace(light, transport=fewer)
            return move_points(made, self.parts) if moved else made

        return self._caches.points((self.parts.keys, coarse), make) if coarse or moved else light

    def _photographed(
        self, view: View, camera: Camera, light: SurfaceLight, guide: FrameGuide
    ) -> PhotographedFrame:
        """Light of a frame when it was photographed."""
        gbuffer = self.scanned(camera)
        hit = gbuffer.hit[..., None]
        photo_light = jnp.where(hit, on_pixels(light.photo_light, light.faces, gbuffer), 1.0)
        hit_weight, one = hit.astype(jnp.float32), jnp.ones(3)
        fields = Shaded(photo_light, jnp.ones_like(photo_light), jnp.eye(3), hit_weight, np.float32(1.0), one)
        features = view_features(guide, view, self.configuration.light.sampling)
        refined = run_kept(refine_illuminance, fields, features, self.configuration.sampled().schedule)
        sources = None
        if light.emitters is not None and view.pose is not None and view.intrinsics is not None:
            seen = dataclasses.replace(view, gbuffer=gbuffer)
            sources = source_pixels(
                light.emitters, seen.source_frame(run=run_kept), *seen.source_surface(run=run_kept)
            )
        return jax.block_until_ready(PhotographedFrame(photo_light, refined, sources))

    def _seen(self, camera: Camera, parts: SceneParts) -> GBuffer:
        """Surface points of parts that a camera sees."""
        name = camera.pose.tobytes(), camera.intrinsics

        def cast(part: Part, key: Hashable) -> GBuffer:
            return self._caches.frames(("g-buffer", name, key), lambda: part.gbuffer(camera))

        return merge_gbuffers([cast(part, key) for part, key in zip(parts.parts, parts.keys, strict=True)])
