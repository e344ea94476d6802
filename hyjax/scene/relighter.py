"""Relighter: frames of a place under new lights, as a configuration says. All relit frames come from here."""

import copy
import dataclasses
import functools
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float

from hyjax.choices.table import CHOICES
from hyjax.configuration import Configuration
from hyjax.core.pyramid import downsample, level_shape
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.guide.choose import NO_GUIDE, RGB, FrameGuide, configured_guide
from hyjax.guide.edge_weights import configured_edges
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.light_edges import Weights
from hyjax.light.photo_light import SurfaceLight, direct_channels
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded, ambient_filter, with_dark_lights
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.pipeline import TemporalFilter, relight_stages
from hyjax.scene.place import AnyLights, Place, camera_view, view_of
from hyjax.scene.point_lux import point_lux
from hyjax.scene.settings import Occluders
from hyjax.util.arguments import checked_arguments
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError
from hyjax.util.programs import run_kept
from hyjax.util.tracing import Run
from hyjax.video import CarriedGuide, Video

TRACED_MESSAGE = (
    "lights: are traced, as by jax.grad or jax.jit, and no shadow maps can be cast then; cast them first "
    "(scene.shadow_maps) and shade by view.shade(lights, shadow_maps=...)"
)
"""Message about lights whose values are not known yet."""
MOST_POINTS = 20_000
"""Most points of the surface at which each light's share is measured."""
T = TypeVar("T")
Stages = Iterator[tuple[str, Any]]
Maps = tuple[ShadowMap | None, ...] | None
Shader = Callable[[View, Camera, SurfaceLight | None], tuple[View, Shaded]]
"""Light of a set-up on a view, with that of the surface if it is known, and the view that it is on."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class LitFrame:
    """A frame under new lights, ready to be refined.

    Attributes:
        view: at the size that is worked at.
        light_edges: weights of the network that sharpens the photo's own light; None to leave it as it is.
    """

    view: View
    shaded: Shaded
    features: Float[Array, "h w f"]
    light_edges: Weights | None = None


def refine(
    lit: LitFrame,
    configuration: Configuration,
    *,
    temporal_filter: TemporalFilter | None = None,
    run: Run = run_kept,
) -> Stages:
    """Stages of the refinement of a frame by a configuration's cascades, see `relight_stages`."""
    sampled = configuration.sampled()
    return relight_stages(
        lit.view,
        lit.shaded,
        lit.features,
        sampled.schedule,
        shadow_schedule=sampled.shadow_schedule,
        temporal_filter=temporal_filter,
        mode=sampled.mode,
        light_edges=lit.light_edges,
        run=run,
    )


def refined_picture(lit: LitFrame, configuration: Configuration) -> Float[Array, "h w 3"]:
    """Relit picture alone, linear."""
    return next(result for stage, result in refine(lit, configuration) if stage == "composite")


class Relighter:
    """Relighting of the frames of a place under lights, as a configuration says.

    Shadow maps and the light on the surface are made once, and again when the surface has changed.

    `setup` are its lights, `guide` makes its guides; frames are refined with a number of `dark_lights` beside them.

    Args:
        place: a `Scene`, a `LiveScene`, or another `Place`.
        lights: lights, a set-up, or its name or file.
        configuration: a configuration, its name or file, or a schedule for the default one; None for that one.
        guide: in the place of the configuration's.
        shadows: whether lights cast shadows.
        occluders: what throws them; the paper's form knows the bare surface alone.
        video: whether refined light is carried from each frame to the next.
        whole: whether large frames are relit no smaller than others; with a video or a shader they are not.
        shader: makes the light on a view in the place of shadow maps.
        clock: takes the times of what is made once.

    Raises:
        InputError: any of these cannot be used, or the set-up keeps sources of a photo whose light is kept whole.

    Example:
        relighter = Relighter(scene, "evening-lamps", "fast")
        pictures = [relighter.relit(index).image for index in range(len(scene))]
    """

    @checked_arguments
    def __init__(
        self,
        place: Place,
        lights: AnyLights,
        configuration: Configuration | Schedule | str | Path | None = None,
        *,
        guide: FrameGuide | None = None,
        shadows: bool = True,
        occluders: Occluders = "completed",
        video: bool = False,
        whole: bool = False,
        shader: Shader | None = None,
        clock: StageClock | None = None,
    ) -> None:
        self.place, self.configuration = place, Configuration.of(configuration)
        options = self.configuration
        self._divides = options.light.photo_light == "divided" and place.knows_photo_light
        self.setup = place.lights(lights, at_photo_sources=self._divides)
        self.setup.check_existing(divided=self._divides)
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(self.setup))
        if traced and (self._divides or (shadows and shader is None)):
            raise InputError(TRACED_MESSAGE)
        self.guide = guide or configured_guide(options.guide)
        self._shadows, self._shader, self._clock = shadows, shader, clock or StageClock()
        self._occluders: Occluders = "surface" if options.mode == "paper" else occluders
        self._video = Video() if video else None
        self._whole = whole or video or shader is not None  # refined light is carried on at full size
        self._carried = CarriedGuide(options.guide.every) if video and options.guide.every > 1 else None
        self._device: jax.Device | None = None
        self.dark_lights, self._lock = 0, threading.Lock()
        self._made: tuple[int | None, LightSetup, Maps, SurfaceLight | None] = (None, self.setup, None, None)
        if place.revision is not None:
            self._light()

    def on(self, device: jax.Device) -> "Relighter":
        """The same with its light, and the frames that it relights, on a device."""
        other, (revision, setup, *made) = copy.copy(self), self._light()
        lights, maps, light = jax.device_put((setup.lights, *made), device)
        other._device, other._made = device, (revision, dataclasses.replace(setup, lights=lights), maps, light)
        return other

    @checked_arguments
    def scale(self, camera: Camera) -> int:
        """Factor by which the frame of a camera is smaller when it is relit, see `Configuration.scale_of`."""
        sampled = self.configuration.sampled()
        return sampled.scale if self._whole else sampled.scale_of(camera.intrinsics.shape)

    @checked_arguments
    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface that a camera sees, at the size that is worked at; see `Scene.gbuffer`."""
        return self.place.gbuffer(scaled(camera, self.scale(camera)), rays=rays)

    @checked_arguments
    def view(self, frame: int | Frame) -> View:
        """View of a frame, at the size that is worked at."""
        opened = self.place.frame(frame)
        return self._view(opened, self.gbuffer(opened.camera))

    @checked_arguments
    def shade(self, view: View) -> Shaded:
        """Light on the surface in a view of the place."""
        if self._shader is not None:
            raise InputError("shade: the light is made of whole frames here; use stages or relit")
        *_, (_, shaded) = self._shade_stages(view)
        return shaded

    @checked_arguments
    def relit(self, frame: int | Frame, *, rays: bool = False) -> Relit:
        """Relit frame.

        Args:
            frame: any of the place, or its position.
            rays: see `Scene.gbuffer`.
        """
        opened = self.place.frame(frame)
        *_, (_, relit) = self.stages(opened, gbuffer=self.gbuffer(opened.camera, rays=rays))
        return relit

    @checked_arguments
    def picture(self, frame: int | Frame) -> Float[Array, "h w 3"]:
        """Relit picture alone, linear; nothing to compare it with is made."""
        return refined_picture(self.lit(frame), self.configuration)

    @checked_arguments
    def stages(self, frame: int | Frame, *, gbuffer: GBuffer | None = None, view: View | None = None) -> Stages:
        """Frame stage by stage: each stage's name with its result. The last is `Relit`, see `relight_stages`.

        Args:
            frame: any of the place, or its position.
            gbuffer: of its camera, where it was made before, see `Relighter.gbuffer`.
            view: of the frame, where it was made before, see `Relighter.view`.
        """
        remember = None
        for stage, result in self._lit_stages(frame, gbuffer, view):
            yield stage, result
        if self._video is not None:
            schedule = self.configuration.sampled().schedule
            remember = self._video.filter(result.view, self.setup, result.features, schedule)
        yield from refine(result, self.configuration, temporal_filter=remember)

    @checked_arguments
    def lit(self, frame: int | Frame, *, gbuffer: GBuffer | None = None) -> LitFrame:
        """All that the refinement of a frame takes. Arguments: see `stages`."""
        return StageClock().follow(self._lit_stages(frame, gbuffer))

    def _lit_stages(self, frame: int | Frame, gbuffer: GBuffer | None = None, view: View | None = None) -> Stages:
        """Stages up to a `LitFrame`."""
        opened = self.place.frame(frame)
        if view is None:
            if gbuffer is None:
                gbuffer = self.gbuffer(opened.camera)
                yield "g-buffer", gbuffer
            view = self._view(opened, gbuffer)
            yield "view", view
        if self._shader is None:
            for stage, shaded in self._shade_stages(view, self.configuration.interleave, direct_alone=True):
                yield stage, shaded
        else:
            camera = scaled(opened.camera, self.scale(opened.camera))
            view, shaded = self._shader(view, camera, self._light()[-1])
            yield "shaded", shaded
        make = functools.partial(view_features, self.guide, view, self.configuration.light.sampling)
        features = make() if self._carried is None else self._carried.features(view, make)
        edges = configured_edges(self.configuration.light, self._light()[-1]) if self._divides else None
        shaded = with_dark_lights(shaded, dark, run=run_kept) if (dark := self.dark_lights) else shaded
        yield "guide", LitFrame(view, shaded, features, self._on_device(edges))

    def _view(self, frame: Frame, gbuffer: GBuffer) -> View:
        if (scale := self.scale(frame.camera)) == 1:
            return self._on_device(view_of(frame, gbuffer))
        full, camera = jax.device_put(frame.image), scaled(frame.camera, scale)
        return self._on_device(camera_view(run_kept(downsample, full, factor=scale), gbuffer, camera, full, scale))

    def _on_device(self, arrays: T) -> T:
        """Arrays on the device of this relighter, where it has one of its own."""
        return arrays if self._device is None else jax.device_put(arrays, self._device)

    def _shade_stages(self, view: View, interleave: int = 1, *, direct_alone: bool = False) -> Stages:
        _, setup, maps, light = self._light()
        lights, bounces = setup.lights, direct_alone and light is not None and light.bounced is not None
        direct = direct_channels(lights, bounces)  # light that gives nothing needs no shading and no cascade
        setup = dataclasses.replace(setup, lights=tuple(lights[k] for k in direct))
        maps = maps and tuple(maps[k] for k in direct)
        shade = functools.partial(view.shade_stages, setup, shadow_maps=maps, surface_light=light, run=run_kept)
        for stage, result in shade(interleave=interleave):
            fewer = stage == "shaded" and len(direct) < len(lights)
            yield stage, dataclasses.replace(result, ambient=self._ambient) if fewer else result

    @functools.cached_property
    def _ambient(self) -> Float[Array, "3"]:
        return run_kept(ambient_filter, self.setup.lights, self.setup.reference_lux)

    def _light(self) -> tuple[int | None, LightSetup, Maps, SurfaceLight | None]:
        """Lights with their shadow maps and the light on the surface as it is now."""
        with self._lock:
            revision, maps, light = self.place.revision, None, None
            if revision is None or revision != self._made[0]:
                if self._shadows and self._shader is None:
                    with self._clock("shadow maps"):
                        maps = self._shadow_maps()
                if self._divides:
                    with self._clock("photo light"):
                        light = jax.block_until_ready(self._surface_light())
                setup = self.setup
                if self._device is not None:
                    lights, maps, light = jax.device_put((setup.lights, maps, light), self._device)
                    setup = dataclasses.replace(setup, lights=lights)
                self._made = revision, setup, maps, light
            return self._made

    def _shadow_maps(self) -> tuple[ShadowMap | None, ...]:
        """Shadow maps; None for a light that gives too little to cast a shadow."""
        options = self.configuration.shadows
        maps = self.place.shadow_maps(
            self.setup, occluders=self._occluders, scale=options.map_scale, most_views=options.views
        )
        casting = casters(self.place, self.setup.lights, options.least_share)
        return tuple(shadow_map if casts else None for shadow_map, casts in zip(maps, casting, strict=True))

    def _surface_light(self) -> SurfaceLight:
        light = self.place.surface_light(self.setup, shadows=self._shadows, occluders=self._occluders)
        return configured_light(light, self.configuration)


def view_features(guide: FrameGuide, view: View, sampling: int) -> Float[Array, "h w f"]:
    """Features of a guide for a view; a network sees the picture before it is sampled."""
    if guide.name in (RGB.name, NO_GUIDE) or sampling == 1 or view.full is None:
        return guide.features(view.display)
    return downsample(guide.features(downsample(view.full, view.factor // sampling)), sampling)


def configured_light(light: SurfaceLight, configuration: Configuration) -> SurfaceLight:
    """Light on the surface as a configuration's choices of it make it, in the order of the table."""
    for name, choice in CHOICES.items():
        if choice.use is not None:
            light = choice.use(light, configuration.value(name))
    return light


def casters(place: Place, lights: Sequence[Light], least_share: float) -> tuple[bool, ...]:
    """Whether each light casts a shadow: not if it gives a smaller share than the least."""
    return tuple(shares(place, lights) >= least_share) if least_share else (True,) * len(lights)


def shares(place: Place, lights: Sequence[Light]) -> np.ndarray:
    """Share of each light in the unshadowed light on the surface."""
    mesh = place.caster.arrays
    chosen = np.unique(np.linspace(0, len(mesh.faces) - 1, min(MOST_POINTS, len(mesh.faces))).astype(int))
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)[chosen]]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1)
    normal = doubled / np.maximum(area, 1e-12)[:, None]
    lux = np.where(area[:, None] > 0, point_lux(corners.mean(axis=1), normal, lights), 0.0)
    given = area @ lux * [float(np.mean(np.asarray(light.color))) for light in lights]
    return given / max(float(given.sum()), 1e-12)


def scaled(camera: Camera, factor: int) -> Camera:
    """Camera of the picture whose pixels are cells of `factor` × `factor`."""
    k = camera.intrinsics
    height, width = level_shape((k.height, k.width), factor)
    parts = (length / factor for length in (k.fx, k.fy, k.cx, k.cy))
    return Camera(Intrinsics(width, height, *parts), camera.pose)
