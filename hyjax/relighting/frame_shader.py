"""Light on the frames of a run: by shadow maps, on every device that takes frames, or by Blender."""

import dataclasses
from collections.abc import Sequence
from contextlib import ExitStack

import jax
import jax.numpy as jnp
import numpy as np

from hyjax.configuration import Configuration
from hyjax.geometry.camera import Camera
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene
from hyjax.scene.settings import Occluders
from hyjax.util.clock import StageClock
from hyjax.util.environment import cores

MOST_AT_ONCE = 4
"""Frames on one processor: each takes memory."""
MOST_POINTS = 20_000
"""Of the surface, that tell how much each light gives."""


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
        configuration: Configuration,
        clock: StageClock,
        stack: ExitStack,
    ) -> None:
        self.setup, self._clock, self._blender = setup, clock, None
        self.sampling = configuration.sampling if settings.renderer == "shadow_map" else 1
        maps = None
        if settings.renderer == "blender":
            from hyjax.scene.blender import BlenderRenderer  # trimesh is slow to load

            with clock("blender start"):
                blender = BlenderRenderer(scene.mesh, setup.lights, shadows=settings.shadows)
                self._blender = stack.enter_context(blender)
        elif settings.shadows:
            with clock("shadow maps"):
                maps = shadow_maps(scene, setup, configuration, settings)
        light = None
        if configuration.light.photo_light == "divided":
            with clock("photo light"):
                light = jax.block_until_ready(surface_light(scene, setup, configuration, settings))
        # Blender, and what frames leave to the next, there is once.
        once = settings.video or settings.renderer == "blender"
        self.devices = jax.local_devices()[: 1 if once else None]
        # Small stages run on one core each, so that frames share the cores of a processor best.
        several = not once and self.devices[0].platform == "cpu"
        self.at_once = max(len(self.devices), min(cores(), MOST_AT_ONCE) if several else 1)
        self._lights = [(setup, maps, light)]
        if len(self.devices) > 1:
            copies = [jax.device_put((setup.lights, maps, light), device) for device in self.devices]
            self._lights = [(dataclasses.replace(setup, lights=lights), *rest) for lights, *rest in copies]

    def __call__(self, number: int, view: View, camera: Camera) -> tuple[View, Shaded]:
        """The `number`-th view of the run, on the device that has it, and the light on what its camera sees."""
        setup, maps, light = self._lights[number % len(self._lights)]
        if self._blender is not None:
            with self._clock("blender"):
                rendering = self._blender.render(camera)
            view, shaded = rendering.shade(view, self.setup)
            if light is not None:
                shaded = view.add_surface_light(shaded, light, setup.lights)
            return view, shaded
        if len(self.devices) > 1:
            view = jax.device_put(view, self.devices[number % len(self.devices)])
        return view, self._clock.follow(
            view.shade_stages(setup, shadow_maps=maps, surface_light=light, sampling=self.sampling)
        )


def shadow_maps(
    scene: Scene, setup: LightSetup, configuration: Configuration, settings: RelightSettings
) -> tuple[ShadowMap | None, ...]:
    """Shadow maps as a configuration wants them: None for a light that gives too little to cast a shadow."""
    options = configuration.shadows
    maps = scene.shadow_maps(
        setup, occluders=occluders_of(configuration, settings), scale=options.map_scale, most_views=options.views
    )
    if not options.least_share:
        return maps
    given = shares(scene, setup.lights)
    return tuple(own if share >= options.least_share else None for own, share in zip(maps, given, strict=True))


def occluders_of(configuration: Configuration, settings: RelightSettings) -> Occluders:
    """What throws shadows; the paper's form knows the bare surface alone."""
    return "surface" if configuration.mode == "paper" else settings.occluders


def shares(scene: Scene, lights: Sequence[Light]) -> np.ndarray:
    """Share of each light in the unshadowed light on the surface."""
    mesh = scene.caster.arrays
    chosen = np.unique(np.linspace(0, len(mesh.faces) - 1, min(MOST_POINTS, len(mesh.faces))).astype(int))
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)[chosen]]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1)
    normal = doubled / np.maximum(area, 1e-12)[:, None]
    position = jnp.asarray(corners.mean(axis=1)[None], jnp.float32)
    points = GBuffer(position, jnp.asarray(normal[None], jnp.float32), jnp.ones(area.shape)[None], area[None] > 0)
    lux = np.asarray(shade_each(points, lights))[0]
    given = area @ lux * [float(np.mean(np.asarray(light.color))) for light in lights]
    return given / max(float(given.sum()), 1e-12)


def surface_light(
    scene: Scene, setup: LightSetup, configuration: Configuration, settings: RelightSettings
) -> SurfaceLight:
    """Photo's light and bounces on the scan, as a configuration wants them."""
    options = configuration.light
    light = scene.surface_light(setup, shadows=settings.shadows, occluders=occluders_of(configuration, settings))
    if options.photo_exponent != 1.0:
        light = dataclasses.replace(light, photo_light=light.photo_light**options.photo_exponent)
    bounced = options.bounce_gain * light.bounced if options.bounces and light.bounced is not None else None
    return dataclasses.replace(light, bounced=bounced)
