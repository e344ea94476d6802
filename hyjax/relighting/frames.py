"""Relit frames of a run in their order: by a `Relighter` on every device that takes frames, or by WebGPU."""

import contextlib
import dataclasses
import functools
import itertools
import logging
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hyjax.configuration import Configuration
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.guide.choose import FrameGuide
from hyjax.light.gbuffer import GBuffer
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.relighter import Relighter, Shader
from hyjax.scene.scene import Scene
from hyjax.util.clock import StageClock
from hyjax.util.cores import cores
from hyjax.util.errors import InputError
from hyjax.util.prefetch import DEPTH, prefetch

MOST_RAY_CAST = 3
"""Most frames whose G-buffers are cast by rays: fewer take less time than the rasteriser takes to load."""
MOST_AT_ONCE = 4
"""Frames that one processor relights at a time: each takes memory."""
MOST_PIXELS_AT_ONCE = 1_500_000
"""Pixels of all frames that a processor relights at a time; a larger frame is alone."""
_log = logging.getLogger(__name__)


def _no_stages() -> Relit:
    raise AssertionError("no stages are kept of this frame")


@dataclasses.dataclass
class RelitFrame:
    """Relit frame of a run.

    Attributes:
        image: relit picture, linear; None where the frame sees no surface.
        compared: makes all stages, for one call; what it needs is kept until `forget`.
    """

    frame: Frame
    image: Float[Array, "h w 3"] | None = None
    compared: Callable[[], Relit] = _no_stages

    def forget(self) -> None:
        """Let go of the picture and its stages: the next frame needs the memory."""
        self.image, self.compared = None, _no_stages


def readable(scene: Scene, index: int) -> Frame | None:
    """A frame of a scene; None, with a line, for one whose picture is damaged, unless the capture is strict."""
    try:
        return scene.frame(index)
    except InputError as error:
        if scene.capture.strict:
            raise
        _log.warning("%s; this frame is left out", error)
        return None


def cycles(
    scene: Scene, setup: LightSetup, settings: RelightSettings, clock: StageClock, stack: ExitStack
) -> Shader:
    """Shader by Blender, which ends with the stack."""
    from hyjax.scene.blender import BlenderRenderer  # trimesh is slow to load

    with clock("blender start"):
        blender = stack.enter_context(BlenderRenderer(scene.mesh, setup.lights, shadows=settings.shadows))

    def shade(view: View, camera: Camera, light: SurfaceLight | None) -> tuple[View, Shaded]:
        with clock("blender"):
            rendering = blender.render(camera)
        own, shaded = rendering.shade(view, setup)
        return own, shaded if light is None else own.add_surface_light(shaded, light, setup.lights)

    return shade


def relit_frames(
    scene: Scene,
    chosen: Sequence[int],
    relighter: Relighter,
    clock: StageClock,
    *,
    once: bool,
    after_first: Callable[[], None] = lambda: None,
) -> Generator[RelitFrame]:
    """Relit frames in order, on each device in turns, unless frames must follow each other (`once`).

    `after_first` is called before the second.
    """
    devices = jax.local_devices()[: 1 if once else None]
    # Small stages run on one core each, so that frames share the cores of a processor best.
    several = not once and devices[0].platform == "cpu"
    relighters = [relighter.on(device) for device in devices] if len(devices) > 1 else [relighter]

    def cast(index: int) -> tuple[Frame, GBuffer] | None:
        with clock("read"):
            frame = readable(scene, index)
        if frame is None:
            return None
        with clock("g-buffer"):
            return frame, jax.block_until_ready(relighter.gbuffer(frame.camera, rays=len(chosen) <= MOST_RAY_CAST))

    turns = itertools.count()

    def relight_frame(seen: tuple[Frame, GBuffer]) -> RelitFrame:
        frame, gbuffer = seen
        if not np.asarray(gbuffer.hit).any():
            return RelitFrame(frame)
        stages = relighters[next(turns) % len(relighters)].stages(frame, gbuffer=gbuffer)
        image = clock.follow(stages, until="composite")
        return RelitFrame(frame, image, functools.partial(clock.follow, stages))

    # The first alone: several at once would each compile what it compiles.
    remaining = iter(chosen)
    first = list(itertools.islice(filter(None, map(cast, remaining)), 1))
    alone = several and bool(first) and 2 * first[0][0].image[..., 0].size > MOST_PIXELS_AT_ONCE
    if first:
        yield relight_frame(first.pop())
    if len(chosen) > 1:
        after_first()
    at_once = max(len(devices), min(cores(), MOST_AT_ONCE) if several and not alone else 1)
    with contextlib.closing(prefetch(cast, remaining, 1 if alone else DEPTH)) as casts:
        cast_ahead = filter(None, casts)
        if alone and at_once == 1:
            yield from map(relight_frame, cast_ahead)
        else:
            with contextlib.closing(prefetch(relight_frame, cast_ahead, at_once, threads=at_once)) as relit:
                yield from relit


def relit_on_device(
    scene: Scene,
    chosen: Sequence[int],
    setup: LightSetup,
    settings: RelightSettings,
    configuration: Configuration,
    guide: FrameGuide,
    clock: StageClock,
    device: Any,
) -> Generator[RelitFrame]:
    """Frames relit by WebGPU, in order."""
    from hyjax.device.renderer import DeviceRenderer

    renderer: DeviceRenderer | None = None
    for index in chosen:
        with clock("read"):
            frame = readable(scene, index)
        if frame is None:
            continue
        with clock("guide"):
            features = jax.block_until_ready(guide.features(jnp.asarray(frame.image)))
        if guide.name != "rgb" and features.shape[-1] == 3:
            raise InputError(
                "guide: webgpu takes three features for the frame itself; train with another --features"
            )
        size = frame.camera.intrinsics.shape
        if renderer is None or renderer.program.size != size:
            with clock("shadow maps"):
                renderer = DeviceRenderer(
                    scene,
                    setup,
                    size,
                    configuration.schedule,
                    configuration.shadow_schedule,
                    features=features.shape[-1],
                    shadows=settings.shadows,
                    light=configuration.light,
                    occluders="surface" if settings.mode == "paper" else settings.occluders,
                    device=device,
                )
        with clock("frame"):
            relit = renderer.relit(frame.image, frame.camera, features)
        whole = functools.partial(lambda known: known, relit)
        yield RelitFrame(frame, relit.image, whole) if renderer.sees_surface else RelitFrame(frame)
