"""Renderer of a tour: pictures of a plan, with everything cached that a change leaves as it was.

The slow steps follow each other: surface → shadow maps → light on each pixel (`layers`) → diffusion. Brightness and
colour of a light change only the last.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
from msgspec.structs import replace

from hyjax.choices.table import LARGEST_SCALE
from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit, fit_camera, spread
from hyjax.geometry.camera import Camera
from hyjax.guide.choose import configured_guide
from hyjax.light.color import to_display
from hyjax.light.photo_light import on_pixels
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.scene.light_places import LightAnchors, survey_capture
from hyjax.scene.light_setups import tell_made_up
from hyjax.scene.relighter import LitFrame, Relighter, configured_light, refine, scaled
from hyjax.scene.scene import Scene
from hyjax.tour.arrangement import Arrangement
from hyjax.tour.editable_scene import EditableScene
from hyjax.tour.furniture import merge_gbuffers
from hyjax.tour.layers import Caches, KeptGuide, lit_surface
from hyjax.tour.lighting import Lighting, flicker, lights_from_outside
from hyjax.tour.picture import (
    COMPARED_STAGES,
    Reach,
    RenderedFrame,
    reach_of,
    shown_stage,
    surface_stage,
)
from hyjax.tour.placement import place_lamp, sunny_plan
from hyjax.tour.plan import LampKind, TourPlan
from hyjax.tour.uncovered import Source, extend_planes, uncovered_pixels, with_uncovered
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError
from hyjax.util.images import to_bytes

if TYPE_CHECKING:
    from hyjax.live.scene import LiveScene

ALBEDO = 0.6
"""Of a mesh whose true colours are unknown."""
LOOKED_AT = 24
"""Frames that are looked at for what furniture uncovers."""
EXPOSED_FRAMES = 8
"""Frames that see the surface for which plans are exposed."""
DRAFT_FACTOR = 2
"""Factor by which a frame is smaller when its draft is relit."""


class Renderer:
    """Renders frames of a capture as a plan lights and furnishes them.

    Attributes:
        scene: the surface, which plans edit.
        lighting: lights of plans in it.
        photo_light: that the frames were taken under; None if it stays in the pictures.
        live: whether frames arrive, see `hyjax.tour.live`.
        numbering: number of the times that frames were numbered anew.

    Args:
        place: surface, and frames unless they are given.
        keep_photo_light: whether to leave the light that the frames were taken under in the pictures, and bounces
            out.
    """

    live = False
    numbering = 0

    def __init__(
        self,
        place: "Scene | LiveScene",
        capture: Capture | None = None,
        *,
        folder: Path = Path(),
        keep_photo_light: bool = False,
        configuration: Configuration | None = None,
    ) -> None:
        self.place, self.folder = place, folder
        if capture is None:
            assert isinstance(place, Scene)
            capture = place.capture
        self.capture = capture
        self.configuration = configuration or Configuration()
        if keep_photo_light:
            self.configuration = self.configuration.with_choices({"photo_light": "kept"})
        self.guide = configured_guide(self.configuration.guide)
        self.up = np.asarray(self.capture.up, float)
        self.photo_light = None
        if isinstance(place, Scene) and self.configuration.light.photo_light == "divided":
            self.photo_light = place.photo_light
            assert self.photo_light.estimate  # made now, if it was not before
        self.forget_frames()
        self.follow()

    def follow(self) -> None:
        """Render on the place's surface as it is now; a picture at work is finished on the one before."""
        self.scene = self._editable()
        self.expose()

    def expose(self) -> None:
        """Expose plans for the surface as it is now."""
        photo = None if self.photo_light is None else self.photo_light.estimate.light
        cameras = self._cameras_of(EXPOSED_FRAMES).values()
        self.lighting = Lighting(self.scene.caster, list(cameras) or [self.captured_camera(0)], self.up, photo)

    def forget_frames(self) -> None:
        """Forget all that is known of frames by their numbers, which are other ones now."""
        self._caches, self._cameras, self._compiled = Caches(), dict[int, Camera](), False
        self.numbering += 1

    def _editable(self) -> EditableScene:
        place: Any = self.place
        return EditableScene(place.caster, self.up, self.folder, place.occluders, place.slack)

    def first_plan(self) -> TourPlan:
        """Plan of a sunny afternoon, with the windows or the open sky that named set-ups have here."""
        return sunny_plan(self._anchors())

    def tell_made_up(self) -> None:
        """Log which places of the first plan's light are made up."""
        found = self._anchors()
        tell_made_up("tour", found, lights_from_outside(sunny_plan(found), self.up)[0])

    def _anchors(self) -> LightAnchors:
        if isinstance(self.place, Scene):
            return self.place.anchors(at_photo_sources=self.photo_light is not None)
        # The walls of a scan that has only begun may still come.
        return dataclasses.replace(survey_capture(self.scene.caster, self.capture), open_sky=False)

    def frame(self, index: int) -> Frame:
        """A frame at the size that is worked at."""
        return self._caches.frames(("frame", index), lambda: fit(self.capture.picture(index), self.place.size))

    def camera(self, index: int) -> Camera:
        """Camera of a frame at the size that is worked at."""
        return self.frame(index).camera

    def _cameras_of(self, most: int, *others: int) -> dict[int, Camera]:
        """Cameras of frames that are evenly spread, and of others; without those that cannot be read."""
        found = {}
        for index in {*others, *spread(range(len(self.capture)), most)}:
            with contextlib.suppress(InputError):  # told when the frame is shown
                found[index] = self.captured_camera(index)
        return found

    def view_camera(self, index: int) -> Camera:
        """Camera of a frame at the size that is worked at; a picture is read for it only where the capture must."""
        return fit_camera(self.captured_camera(index), self.place.size)

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
            draft: whether half the frame's size, and coarse shadow maps, will do where something has just moved.
            cancelled: asked before each view of a shadow map that must be cast; true ends the rendering.

        Raises:
            RenderCancelled: it was cancelled. What has been cast so far is kept.
        """
        flames = {k: flicker(seconds, k) for k, lamp in enumerate(plan.lamps) if lamp.kind == "candle"}
        setup = self._setup(plan, flames if seconds else None)
        if viewpoint.camera is not None:
            return self._free(plan, setup, viewpoint, draft, cancelled)
        clock, index, keep = StageClock(), viewpoint.frame, self._caches.frames
        frame = self.frame(index)
        configuration = self._configured(viewpoint.schedule, fully=viewpoint.shown == "raw filter")
        own = Arrangement(
            self.scene, plan, self._caches, self.photo_light, configuration, draft=draft, cancelled=cancelled
        )
        small = draft and viewpoint.shown == "relit" and self._compiled and configuration.mode != "paper"
        small &= DRAFT_FACTOR * configuration.scale <= LARGEST_SCALE
        if small := small and (("view", index, own.scale) not in keep or own.any_coarse(setup, index)):
            own = own.smaller(DRAFT_FACTOR)
            configuration = own.configuration
        guide = KeptGuide(self.guide, functools.partial(keep, ("guide", index, configuration.scale, own.scale)))
        shader = functools.partial(own.shade, index, guide, setup)
        relighter = Relighter(own, setup, configuration, guide=guide, shader=shader, clock=clock)
        with clock("g-buffer"):
            nothing: Any = None  # the surface may be another each time
            pixels = keep(
                ("view", index, own.scale),
                lambda: jax.block_until_ready(dataclasses.replace(relighter.view(frame), gbuffer=nothing)),
            )
            view = dataclasses.replace(pixels, gbuffer=relighter.gbuffer(frame.camera))
        lit: LitFrame = clock.follow(relighter.stages(frame, view=view), until="guide")
        stages = refine(lit, configuration, run=own.run)
        result = clock.follow(stages, until=None if viewpoint.shown in COMPARED_STAGES else "composite")
        unseen = False
        if plan.furnishes and not isinstance(result, Relit):
            with clock("uncovered"):
                camera = scaled(frame.camera, DRAFT_FACTOR) if small else frame.camera
                frames = {k: self.view_camera(k) for k in self._cameras_of(LOOKED_AT, index)}
                result, unseen = with_uncovered(result, own, setup, camera, self.scene.planes, frames, self._source)
        with clock("show"):
            linear = np.asarray(result.image if isinstance(result, Relit) else result)
            if viewpoint.shown == "photo":
                picture = keep(("photo", index), lambda: to_bytes(frame.image))
            else:
                picture = shown_stage(viewpoint.shown, frame, lit, result, configuration.sampled().schedule)
        times = {stage: 1e3 * values[-1] for stage, values in clock.seconds.items()}
        self._compiled |= not small
        reach = self._reach(plan, lit.shaded)
        return RenderedFrame(picture, linear, frame, times, small or own.coarse, unseen, reach)

    def _source(self, index: int) -> Source | None:
        """Frame as pixels are taken of it."""
        read = functools.partial(self.frame, index)
        return self._caches.frames(("source", index), lambda: Source.of(read, self.scene.caster))

    def _reach(self, plan: TourPlan, shaded: Shaded) -> tuple[Reach | None, ...]:
        """Reach of each lamp."""
        if not plan.lamps:
            return ()
        outside = len(self.lighting.outside(plan).lights)
        found = iter(np.asarray(reach_of(shaded)).T[outside:].tolist())  # those that are on follow in their order
        return tuple(Reach(*next(found)) if lamp.on and lamp.lumen > 0 else None for lamp in plan.lamps)

    def _free(
        self, plan: TourPlan, setup: LightSetup, viewpoint: Viewpoint, draft: bool, cancelled: Callable[[], bool]
    ) -> RenderedFrame:
        """The lit mesh as a camera sees it that has no photo: albedo times light, which needs no repair."""
        clock, camera, shown = StageClock(), viewpoint.camera, viewpoint.shown
        assert camera is not None
        configuration = self._configured(self.configuration.schedule, fully=True)
        own = Arrangement(
            self.scene, plan, self._caches, self.photo_light, configuration, draft=draft, cancelled=cancelled
        )
        with clock("g-buffer"):
            seen = merge_gbuffers([part.gbuffer(camera) for part in own.parts.parts])
            if plan.furnishes:  # floor and walls go on where the scan has a hole beneath them
                (scanned,) = self.scene.apply(TourPlan()).parts
                uncovered = uncovered_pixels(seen, scanned.gbuffer(camera), self.scene.caster)
                seen = extend_planes(seen, uncovered, camera, self.scene.planes)
        light, albedo = None, jnp.float32(ALBEDO)
        with clock("photo light"):
            if self.photo_light is not None:
                light = configured_light(own.surface_light(setup), configuration)
                photo = self.photo_light.estimate.light
                albedo = photo.mean * on_pixels(photo.albedo[: photo.transport.vertices], light.faces, seen)
        with clock("shaded"):
            shaded = own.shade_surface(seen, setup, light)
            linear = np.asarray(lit_surface(shaded, albedo, setup.reference_lux))
        with clock("show"):
            image = np.asarray(to_display(linear))
            picture = to_bytes(np.asarray(surface_stage(shown, seen)) if shown in ("normals", "depth") else image)
        times = {stage: 1e3 * values[-1] for stage, values in clock.seconds.items()}
        return RenderedFrame(picture, linear, Frame("free", image, camera, 0.0), times, own.coarse)

    def warm_up(self, plan: TourPlan, viewpoint: Viewpoint) -> Generator[None]:
        """Compile visitors' likely requests, a little each step: lamps and the moon."""
        origin = self.camera(viewpoint.frame).origin
        lamps = tuple(place_lamp(kind, origin, self.up) for kind in get_args(LampKind))
        changes: list[dict[str, Any]] = [{"lamps": (lamp,)} for lamp in lamps]
        for change in [{}, *changes, {"weather": "full moon"}, {"lamps": lamps}]:
            for draft in (True, False):
                self.render(replace(plan, **change), viewpoint, draft=draft)
                yield
        free = dataclasses.replace(viewpoint, camera=self.camera(viewpoint.frame))
        self.render(replace(plan, lamps=lamps[:1]), free)

    def lift(self, plan: TourPlan, viewpoint: Viewpoint) -> Generator[None]:
        """Make ready what the first move of picked pieces takes: the rest of the room, and its shadows."""
        pieces = tuple(replace(piece, removed=piece.removed or piece.as_scanned) for piece in plan.pieces)
        self.render(replace(plan, pieces=pieces), viewpoint, draft=True)
        yield

    def _setup(self, plan: TourPlan, flames: dict[int, float] | None = None) -> LightSetup:
        """Lights of a plan; nothing is left of sources that were not divided out."""
        setup = self.lighting.setup(plan, flames)
        return setup if self.photo_light is not None else dataclasses.replace(setup, existing={})

    def _configured(self, schedule: Schedule, *, fully: bool) -> Configuration:
        """Configuration with another schedule; if fully, with the light of every pixel."""
        light = self.configuration.light
        return dataclasses.replace(
            self.configuration, schedule=schedule, light=light.replace(sampling=1) if fully else light
        )
