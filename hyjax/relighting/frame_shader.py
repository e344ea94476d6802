"""Light on the frames of a run: by shadow maps, on every device that takes frames, or by Blender."""

import dataclasses
from contextlib import ExitStack

import jax

from hyjax.core.cascade import largest_sampling
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.light.gbuffer import GBuffer
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.pipeline import default_shadow_schedule
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene, view_of
from hyjax.util.clock import StageClock
from hyjax.util.environment import cores

MOST_AT_ONCE = 4
"""Frames on one processor: each takes memory."""


class FrameShader:
    """Light on each frame of a run.

    Attributes:
        devices: that frames go to in turns.
        at_once: how many frames may be relit at a time.
        sampling: as the schedules allow it, see `RelightSettings`.
    """

    def __init__(
        self,
        scene: Scene,
        setup: LightSetup,
        settings: RelightSettings,
        schedule: Schedule,
        clock: StageClock,
        stack: ExitStack,
    ) -> None:
        self.setup, self._clock, self._blender = setup, clock, None
        linear = settings.mode == "linear" and settings.renderer == "shadow_map"
        self.sampling = (
            largest_sampling([schedule, default_shadow_schedule("linear")], settings.sampling) if linear else 1
        )
        maps = None
        if settings.renderer == "blender":
            from hyjax.scene.blender import BlenderRenderer  # trimesh is slow to load

            with clock("blender start"):
                blender = BlenderRenderer(scene.mesh, setup.lights, shadows=settings.shadows)
                self._blender = stack.enter_context(blender)
        elif settings.shadows:
            with clock("shadow maps"):
                maps = scene.shadow_maps(setup, occluders=settings.shadow_occluders)
        surface_light = None
        if settings.divides_photo_light:
            with clock("photo light"):
                surface_light = jax.block_until_ready(
                    scene.surface_light(setup, shadows=settings.shadows, occluders=settings.shadow_occluders)
                )
        # Blender, and what frames leave to the next, there is once.
        once = settings.video or settings.renderer == "blender"
        self.devices = jax.local_devices()[: 1 if once else None]
        # Small stages run on one core each, so that frames share the cores of a processor best.
        several = not once and self.devices[0].platform == "cpu"
        self.at_once = max(len(self.devices), min(cores(), MOST_AT_ONCE) if several else 1)
        self._lights = [(setup, maps, surface_light)]
        if len(self.devices) > 1:
            copies = [jax.device_put((setup.lights, maps, surface_light), device) for device in self.devices]
            self._lights = [(dataclasses.replace(setup, lights=lights), *rest) for lights, *rest in copies]

    def __call__(self, number: int, frame: Frame, gbuffer: GBuffer) -> tuple[View, Shaded]:
        """View of a frame, the `number`-th of the run, and the light on it."""
        view = view_of(frame, gbuffer)
        setup, maps, light = self._lights[number % len(self._lights)]
        if self._blender is not None:
            with self._clock("blender"):
                rendering = self._blender.render(frame.camera)
            view, shaded = rendering.shade(view, self.setup)
            if light is not None:
                shaded = view.add_surface_light(shaded, light, setup.lights)
            return view, shaded
        if len(self.devices) > 1:
            view = jax.device_put(view, self.devices[number % len(self.devices)])
        return view, self._clock.follow(
            view.shade_stages(setup, shadow_maps=maps, surface_light=light, sampling=self.sampling)
        )
