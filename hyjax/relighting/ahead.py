"""Programs of a run, compiled while the light of its photos is still being estimated."""

import contextlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from hyjax.configuration import Configuration
from hyjax.guide.choose import FrameGuide
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.setup import LightSetup
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.relighter import Relighter, refined_picture
from hyjax.scene.scene import Scene
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError


class EvenlyLitPlace:
    """A scene as a place whose photos had even light, and where nothing bounces."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)

    def surface_light(self, lights: LightSetup, **_: Any) -> SurfaceLight:
        """Light of the shapes that the estimate has."""
        mesh = self._scene.caster.arrays
        even, none = (make((len(mesh.vertices), 3), np.float32) for make in (np.ones, np.zeros))
        parts = (even, none, np.asarray(mesh.faces, np.int32))
        return SurfaceLight(*map(jax.device_put, parts))


def compile_ahead(
    scene: Scene,
    chosen: Sequence[int],
    setup: LightSetup,
    settings: RelightSettings,
    configuration: Configuration,
    guide: FrameGuide,
    clock: StageClock,
) -> None:
    """Cast the shadow maps, which the scene keeps, and compile the programs of a frame by relighting the first."""
    relighter = Relighter(
        EvenlyLitPlace(scene),
        setup,
        configuration,
        guide=guide,
        shadows=settings.shadows,
        occluders=settings.occluders,
        clock=clock,
    )
    with clock("programs"), contextlib.suppress(InputError):  # of a damaged frame, told in its turn
        frame = scene.frame(chosen[0])
        gbuffer = relighter.gbuffer(frame.camera, rays=True)
        if np.asarray(gbuffer.hit).any():
            jax.block_until_ready(refined_picture(relighter.lit(frame, gbuffer=gbuffer), configuration))
