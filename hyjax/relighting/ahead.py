"""Programs of a run, compiled while the light of its photos is still being estimated."""

import contextlib
import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from hyjax.configuration import Configuration
from hyjax.core.pyramid import level_shape
from hyjax.guide.choose import FrameGuide
from hyjax.guide.edge_weights import edge_weights
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight, direct_channels, direct_light, interreflection
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.shading import shade_each
from hyjax.pipeline import cascade_calls
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.relighter import Relighter, configured_light, refined_picture
from hyjax.scene.scene import Scene
from hyjax.scene.settings import Occluders
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError
from hyjax.util.programs import keeps_programs, kept_function, make_ready
from hyjax.util.quick_programs import are_quick, submit

THREADS = 2
"""Number of threads that compile."""
MOST_QUICK_STEPS = 8.0
"""Most steps at full size, over both cascades, that are run by programs without optimisation: more take longer than
optimising does."""
MOST_DARK_LIGHTS = 3
"""Most dark lights that are added where the cascades of the lights alone are not kept."""


@dataclasses.dataclass(frozen=True)
class DarkLights:
    """Dark lights that frames are refined with, see `Relighter`, until there are cascades without them.

    Attributes:
        count: their number.
        cascades: the cascades without them, with arguments of their shapes.
    """

    count: int = 0
    cascades: tuple[tuple[Any, ...], ...] = ()

    def drop_later(self, relighter: Relighter) -> None:
        """Optimise the cascades on another thread, and refine by them from then on."""

        def drop() -> None:
            for function, *arrays in self.cascades:
                kept_function(function).optimise(*arrays)
            relighter.dark_lights = 0

        if self.count:
            submit(drop)


class EvenlyLitPlace:
    """A scene as a place whose photos had even light, and where nothing bounces."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)

    def surface_light(
        self, lights: LightSetup | Sequence[Light], *, shadows: bool = True, occluders: Occluders = "completed"
    ) -> SurfaceLight:
        """Light of the shapes that the estimate has."""
        mesh = self._scene.caster.arrays
        even, none = (make((len(mesh.vertices), 3), np.float32) for make in (np.ones, np.zeros))
        arrays: Any = (even, none, np.asarray(mesh.faces, np.int32))  # as JAX's, each operation would be a program
        return SurfaceLight(*arrays)


def is_short(configuration: Configuration) -> bool:
    """Whether the cascades take so few steps that their programs may do without optimisation at first."""
    both = configuration.schedule, configuration.shadow_schedule
    return sum(level.steps / level.factor**2 for cascade in both for level in cascade.levels) <= MOST_QUICK_STEPS


def begin_programs(
    scene: Scene,
    chosen: Sequence[int],
    setup: LightSetup,
    configuration: Configuration,
    guide: FrameGuide,
    *,
    video: bool,
    exact: bool = False,
) -> DarkLights:
    """Begin to read or compile the largest programs of a frame on other threads, where programs are kept.

    Whoever runs them waits for them. They are known by the shapes of their arguments alone; those of a network's
    guide, whose features are not counted here, and of the paper's mode are left to the first frame.

    Returns the dark lights to begin with: some where the cascades of the lights alone are not kept, and those of a
    few more are, which need not be compiled first; none where it must be `exact`.
    """
    if configuration.mode != "linear" or guide.name != "rgb" or setup.existing or not keeps_programs():
        return DarkLights()
    try:
        size = scene.size or scene.capture.camera(chosen[0]).intrinsics.shape
    except InputError:  # of a damaged frame, told in its turn
        return DarkLights()
    sampled, direct = configuration.sampled(), tuple(range(len(setup.lights)))
    height, width = level_shape(size, sampled.scale if video else sampled.scale_of(size))

    def array(*shape: int, dtype: type = np.float32) -> Any:
        return jax.device_put(np.zeros(shape, dtype))

    bounced = photo_light = None
    if configuration.light.photo_light == "divided":
        light = configured_light(EvenlyLitPlace(scene).surface_light(setup), configuration)
        direct, photo_light = direct_channels(setup.lights, light.bounced is not None), array(height, width, 3)
        bounced = None if light.bounced is None else photo_light
    picture, known, reference, ambient = array(height, width, 3), array(height, width, 1), array(), array(3)
    numbers, hit, face = (array(height, width, dtype=kind) for kind in (np.float32, bool, np.int32))
    seen = GBuffer(picture, picture, numbers, hit, face, picture)

    def cascades(dark: int) -> tuple[tuple[Any, ...], ...]:
        count = len(direct) + dark
        lights, colors = array(height, width, count), array(count, 3)
        shaded = Shaded(lights, lights, colors, known, reference, ambient, bounced, photo_light)
        return cascade_calls(shaded, picture, sampled.schedule, sampled.shadow_schedule)

    def are_kept(dark: int) -> bool:
        return all(kept_function(function).is_kept(*arrays) for function, *arrays in cascades(dark))

    counts = range(0 if exact or video or not are_quick() else MOST_DARK_LIGHTS + 1)
    dark = next(filter(are_kept, counts), 0)
    pool = ThreadPoolExecutor(THREADS, thread_name_prefix="programs")
    for call in (*cascades(dark), (shade_each, seen, tuple(setup.lights[k] for k in direct))):
        pool.submit(make_ready, *call)
    pool.shutdown(wait=False)
    return DarkLights(dark, cascades(0)) if dark else DarkLights()


def compile_ahead(
    scene: Scene,
    chosen: Sequence[int],
    setup: LightSetup,
    settings: RelightSettings,
    configuration: Configuration,
    guide: FrameGuide,
    clock: StageClock,
) -> None:
    """Cast the shadow maps, which the scene keeps, and compile the programs of a frame by relighting the first.

    What the estimate of the photo's light says of the set-up must change strengths alone.
    """
    begin_programs(scene, chosen, setup, configuration, guide, video=settings.video, exact=True)
    relighter = Relighter(
        EvenlyLitPlace(scene),
        setup,
        configuration,
        guide=guide,
        shadows=settings.shadows,
        occluders=settings.occluders,
        video=settings.video,
        clock=clock,
    )
    with clock("programs"), contextlib.suppress(InputError):  # of a damaged frame, told in its turn
        frame = scene.frame(chosen[0])
        gbuffer = relighter.gbuffer(frame.camera, rays=True)
        if np.asarray(gbuffer.hit).any():
            lit = relighter.lit(frame, gbuffer=gbuffer)
            if configuration.light.edges and lit.shaded.photo_light is not None:  # even here, but not in the scene
                lit = dataclasses.replace(lit, light_edges=edge_weights())
            jax.block_until_ready(refined_picture(lit, configuration))
        if (expected := scene.photo_light.expected()) is not None:
            maps = scene.shadow_maps(setup, occluders=settings.occluders) if settings.shadows else None
            direct = jax.ShapeDtypeStruct(expected.transport.position.shape, np.float32)
            for light, shadow_map in zip(setup.lights, maps or [None] * len(setup.lights), strict=True):
                if not light.UNIFORM:
                    make_ready(direct_light, expected.transport, light, shadow_map)
                    make_ready(interreflection, expected.transport, expected.albedo, direct)
