"""Renderer of a tour: pictures of a plan, with everything cached that a change leaves as it was.

The slow steps follow each other: surface → shadow maps → light on each pixel (`layers`) → diffusion. Brightness and
colour of a light change only the last.
"""

import dataclasses
from collections.abc import Callable, Generator, Hashable
from pathlib import Path
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Float
from msgspec.structs import replace

from hyjax.configuration import Configuration
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.light.color import to_display, to_linear
from hyjax.light.gbuffer import GBuffer, sample_pixels
from hyjax.light.photo_light import least_bounced
from hyjax.light.shading import colored
from hyjax.light.view import View
from hyjax.pipeline import refine_illuminance, refine_visibility
from hyjax.scene.light_places import survey_capture
from hyjax.scene.scene import Scene
from hyjax.tour.editable_scene import EditableScene, SceneParts
from hyjax.tour.furniture import Part, merge_gbuffers
from hyjax.tour.layers import LayerCache, Quality, mebibytes
from hyjax.tour.lighting import flicker, setup_of
from hyjax.tour.picture import DeviceFrame, RenderedFrame, compose, stack_layers, to_bytes
from hyjax.tour.placement import as_point, north_for_bearing, place_lamp
from hyjax.tour.plan import LampKind, TourPlan, Window
from hyjax.tour.room_light import (
    PhotographedFrame,
    RoomLight,
    add_room_light,
    bounced_at_vertices,
    direct_lights,
)
from hyjax.tour.viewpoint import MOST_SAMPLING, Viewpoint
from hyjax.util.clock import StageClock
from hyjax.util.lru_cache import LruCache
from hyjax.util.programs import run_kept

FRAMES_MIB = 128
ALBEDO = 0.6  # of the mesh in the free view, whose true colours are unknown
VERTICES = 1 << 14
"""Number that the vertices of a live mesh are padded to a multiple of."""
AFTERNOON, BEARING = 16.0, 240.0


class Renderer:
    """Renders frames of a capture as a plan lights and furnishes them.

    Attributes:
        capture: frames with poses.
        up: against gravity, world axes.
        scene: the surface, which plans edit.
        surface_area: of floor, walls and ceiling of a box around it, square metres.
        room_light: bounces and the photo's own light; None if that stays in the pictures.
        live: whether frames arrive, see `hyjax.tour.live`.

    Args:
        scene: capture and surface.
        guide: what makes the guide of a frame.
        folder: where uploaded mesh files lie.
        keep_photo_light: whether to leave the light that the frames were taken under in the pictures, and bounces
            out.
        configuration: sampling, shadow pass and light of the pictures.
    """

    live = False

    def __init__(
        self,
        scene: Scene,
        *,
        guide: FrameGuide = RGB,
        folder: Path = Path(),
        keep_photo_light: bool = False,
        configuration: Configuration | None = None,
    ) -> None:
        self.capture, self.guide, self._source = scene.capture, guide, scene
        self.configuration = configuration or Configuration()
        self.up = np.asarray(scene.capture.up, float)
        self.scene = EditableScene(scene.caster, self.up, folder, scene.occluders, scene.slack)
        a, b, c = scene.mesh.extents
        self.surface_area = 2.0 * float(a * b + b * c + c * a)
        self._frames, self._layers = LruCache(FRAMES_MIB, mebibytes), LayerCache()
        self._cameras: dict[int, Camera] = {}
        self.room_light = (
            None if keep_photo_light else RoomLight(scene.photo_light, self._layers, self.configuration)
        )

    def first_plan(self) -> TourPlan:
        """Plan of a sunny afternoon, with the capture's own windows or one near the cameras' view."""
        windows = tuple(
            Window(as_point(a["center"]), as_point(a["normal"]), float(a["width"]), float(a["height"]))
            for name, a in sorted(self.capture.anchors.items())
            if name.startswith("window")
        )
        if not windows:
            found = survey_capture(self.scene.caster, self.capture)
            windows = tuple(
                Window(as_point(w.center), as_point(w.inward), w.width, w.height) for w in found.windows
            )
        north = north_for_bearing(windows[0], BEARING, self.up)
        return TourPlan(hour=AFTERNOON, windows=windows, north=north).check()

    def frame(self, index: int) -> Frame:
        """A frame at the size that is worked at."""
        return self._frames(("frame", index), lambda: self._source.frame(index))

    def camera(self, index: int) -> Camera:
        """Camera of a frame at the size that is worked at."""
        return self.frame(index).camera

    def captured_camera(self, index: int) -> Camera:
        """Camera of a frame as it was captured; its picture is read for it only once."""
        if index not in self._cameras:
            self._cameras[index] = self.capture.camera(index)
        return self._cameras[index]

    def render(
        self,
        plan: TourPlan,
        viewpoint: Viewpoint,
        *,
        draft: bool = False,
        seconds: float = 0.0,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> RenderedFrame:
        """Render a plan from a viewpoint.

        Args:
            plan: what is set up.
            viewpoint: frame, stage and schedule.
            draft: whether coarse shadow maps will do for lights that have just moved.
            seconds: time that has passed, for what flickers.
            cancelled: asked before each view of a shadow map that must be cast; true ends the rendering.

        Raises:
            InputError: a frame or mesh file cannot be read.
            RenderCancelled: it was cancelled. What has been cast so far is kept.
        """
        clock, index = StageClock(), viewpoint.frame
        flames = {k: flicker(seconds, k) for k, lamp in enumerate(plan.lamps) if lamp.kind == "candle"}
        setup = setup_of(plan, self.up, self.surface_area, flames if seconds else None)
        frame = self.frame(index)
        with clock("guide"):
            pixels = self._frames(("device", index), lambda: jax.block_until_ready(self._device_frame(frame)))
        with clock("surface"):
            parts = self.scene.apply(plan)
            gbuffer = self._gbuffer(index, frame, parts)
            sampling, samples = self._sampling(viewpoint), self._samples(viewpoint, gbuffer, parts)
            jax.block_until_ready((gbuffer, samples))
        with clock("light"):
            lights = setup.lights if self.room_light is None else direct_lights(setup.lights)
            coarse = [
                draft and not self._layers.is_fine(light, index, parts, sampling=sampling) for light in lights
            ]
            qualities: list[Quality] = ["draft" if rough else "fine" for rough in coarse]
            layers = [
                self._layers.layer(light, index, samples, parts, quality, cancelled, sampling=sampling)
                for light, quality in zip(lights, qualities, strict=True)
            ]
            jax.block_until_ready(layers)
        view = View(pixels.linear, pixels.display, gbuffer)
        asked, setup = setup.lights, dataclasses.replace(setup, lights=lights)
        shaded = stack_layers(setup, layers, samples.hit, sampling=sampling)
        photo_light: tuple[Float[Array, "h w 3"], ...] = ()
        if self.room_light is not None:
            with clock("bounces"):
                least = least_bounced(asked, self.room_light.filled_share)
                light = self.room_light.surface_light(setup, qualities, parts, least, cancelled)
                photographed = self._photographed(viewpoint, frame, pixels)
                shaded = jax.block_until_ready(add_room_light(shaded, light, photographed, pixels.linear, samples))
                photo_light = (self._refined_photo_light(viewpoint, photographed, pixels),)
        guide, schedule = pixels.guide, viewpoint.schedule
        with clock("cascade"):
            fresh = dataclasses.replace(shaded, photo_light=None)
            illuminance = jax.block_until_ready(run_kept(refine_illuminance, fresh, guide, schedule))
        with clock("shadow pass"):
            visible = jax.block_until_ready(
                run_kept(refine_visibility, shaded, guide, self.configuration.shadow_schedule)
            )
        with clock("composite"):
            fields = illuminance, *photo_light
            picture, linear = compose(viewpoint.shown, view, shaded, guide, schedule, fields, visible)
            picture, linear = np.asarray(picture), np.asarray(linear)
            photo = self._frames(("photo", index), lambda: to_bytes(frame.image))
        times = {stage: 1e3 * values[-1] for stage, values in clock.seconds.items()}
        return RenderedFrame(picture, photo, linear, frame, times, any(coarse))

    def warm_up(self, plan: TourPlan, viewpoint: Viewpoint) -> Generator[None]:
        """Compile viewers' likely requests, a little each step: lamps, the moon, the mesh."""
        origin = self.camera(viewpoint.frame).origin
        lamps = tuple(place_lamp(kind, origin, self.up) for kind in get_args(LampKind))
        changes: list[dict[str, Any]] = [{"lamps": (lamp,)} for lamp in lamps]
        for change in [{}, *changes, {"weather": "full moon"}, {"lamps": lamps}]:
            for draft in (True, False):
                self.render(replace(plan, **change), viewpoint, draft=draft)
                yield
        self.lit_mesh(plan)

    def lit_mesh(self, plan: TourPlan) -> trimesh.Trimesh:
        """The surface as the plan arranges it, its vertices coloured by the light that falls on them."""
        mesh, parts = self.scene.apply_to_mesh(plan), self.scene.apply(plan)
        setup = setup_of(plan, self.up, self.surface_area)
        count = len(mesh.vertices)
        # A mesh that changes has another number of vertices each time, which would compile all again.
        more = -count % VERTICES if self.live else 0
        vertices, normals = (
            jnp.asarray(np.pad(x, ((0, more), (0, 0)), mode="edge"), jnp.float32)[None]
            for x in (mesh.vertices, mesh.vertex_normals)
        )
        ones = jnp.ones(vertices.shape[:2])
        gbuffer = GBuffer(vertices, normals, ones, ones > 0)
        channels = []
        lights = setup.lights if self.room_light is None else direct_lights(setup.lights)
        qualities: list[Quality] = ["fine" if self._layers.has_maps(light, parts) else "draft" for light in lights]
        for light, quality in zip(lights, qualities, strict=True):
            illuminance, visible = self._layers.shade(light, gbuffer, parts, quality)
            channels.append(getattr(light, light.STRENGTH) * illuminance * visible)
        lux = colored(jnp.stack(channels, axis=-1), lights)[:, :count]
        if self.room_light is not None:
            own = dataclasses.replace(setup, lights=lights)
            least = least_bounced(setup.lights, self.room_light.filled_share)
            lux += bounced_at_vertices(self.room_light.surface_light(own, qualities, parts, least), parts)
        shades = lux / setup.reference_lux
        mesh.visual.vertex_colors = to_bytes(to_display(ALBEDO * shades))[0]  # type: ignore[union-attr]
        return mesh

    def _sampling(self, viewpoint: Viewpoint) -> int:
        own = self.configuration
        return viewpoint.sampling(own.shadow_schedule, min(own.light.sampling, MOST_SAMPLING))

    def _device_frame(self, frame: Frame) -> DeviceFrame:
        display = jnp.asarray(frame.image)
        return DeviceFrame(to_linear(display), display, self.guide.features(display))

    def _photographed(self, viewpoint: Viewpoint, frame: Frame, pixels: DeviceFrame) -> PhotographedFrame:
        """Light of a frame when it was photographed, before the plan moved anything."""
        index, sampling = viewpoint.frame, self._sampling(viewpoint)

        def make() -> PhotographedFrame:
            assert self.room_light is not None
            gbuffer = self._gbuffer(index, frame, self.scene.apply(TourPlan()))
            return self.room_light.photographed(frame.camera, pixels.linear, gbuffer, sampling=sampling)

        return self._frames(("photographed", index, sampling), make)

    def _refined_photo_light(
        self, viewpoint: Viewpoint, photographed: PhotographedFrame, pixels: DeviceFrame
    ) -> Float[Array, "h w 3"]:
        key = "photo light", viewpoint.frame, self._sampling(viewpoint), viewpoint.schedule.to_json()
        return self._frames(
            key, lambda: jax.block_until_ready(photographed.refined(pixels.guide, viewpoint.schedule))
        )

    def _samples(self, viewpoint: Viewpoint, gbuffer: GBuffer, parts: SceneParts) -> GBuffer:
        sampling = self._sampling(viewpoint)
        if sampling == 1:
            return gbuffer
        key = "samples", viewpoint.frame, sampling, parts.keys
        return self._frames(key, lambda: run_kept(sample_pixels, gbuffer, sampling=sampling))

    def _gbuffer(self, index: int, frame: Frame, parts: SceneParts) -> GBuffer:
        def cast(part: Part, key: Hashable) -> GBuffer:
            return self._frames(("g-buffer", index, key), lambda: part.gbuffer(frame.camera))

        return merge_gbuffers([cast(part, key) for part, key in zip(parts.parts, parts.keys, strict=True)])
