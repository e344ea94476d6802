"""Relighting of single frames by a configuration: G-buffer, light, guide, cascades, picture."""

import dataclasses
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import jax
from jaxtyping import Array, Float

from hyjax.configuration import Configuration
from hyjax.core.pyramid import downsample, level_shape
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.guide.choose import FrameGuide, configured_guide
from hyjax.light.gbuffer import GBuffer
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.pipeline import TemporalFilter, relight_stages
from hyjax.relighting.frame_shader import FrameShader
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene, camera_view, view_of
from hyjax.util.clock import StageClock
from hyjax.video import CarriedGuide, Video


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class LitFrame:
    """A frame under new lights, ready to be refined.

    Attributes:
        view: at the size that is worked at.
        shaded: light on it.
        features: of the guide.
        full: the frame at full size, where the view is smaller.
    """

    view: View
    shaded: Shaded
    features: Float[Array, "h w f"]
    full: Float[Array, "fh fw 3"] | None = None


def refine(
    lit: LitFrame, configuration: Configuration, *, temporal_filter: TemporalFilter | None = None
) -> Iterator[tuple[str, Any]]:
    """Stages of the refinement of a frame by a configuration's cascades, see `relight_stages`."""
    return relight_stages(
        lit.view,
        lit.shaded,
        lit.features,
        configuration.schedule,
        shadow_schedule=configuration.shadow_schedule,
        temporal_filter=temporal_filter,
        mode=configuration.mode,
        full=lit.full,
    )


def refined_picture(lit: LitFrame, configuration: Configuration) -> Float[Array, "h w 3"]:
    """Relit picture alone, linear."""
    return next(result for stage, result in refine(lit, configuration) if stage == "composite")


class FrameRelighter:
    """Relighting of the frames of a scene under a set-up, as a configuration says.

    Attributes:
        configuration: how.
        guide: what makes the guides.
        shader: light on the frames.

    Args:
        scene: whose frames they are.
        setup: new lights.
        configuration: how.
        settings: renderer, shadows, occluders and video.
        guide: in the place of the configuration's.
        clock: takes the stages' times.
        stack: closes what is opened.
    """

    def __init__(
        self,
        scene: Scene,
        setup: LightSetup,
        configuration: Configuration,
        settings: RelightSettings | None = None,
        *,
        guide: FrameGuide | None = None,
        clock: StageClock | None = None,
        stack: ExitStack | None = None,
    ) -> None:
        settings, self._clock = settings or RelightSettings(), clock or StageClock()
        self.configuration, self._scene, self._video = configuration, scene, Video() if settings.video else None
        carries = settings.video and configuration.guide.every > 1
        self._carried = CarriedGuide(configuration.guide.every) if carries else None
        self.guide = guide or configured_guide(configuration.guide)
        self.shader = FrameShader(scene, setup, settings, configuration, self._clock, stack or ExitStack())

    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface that a camera sees, at the configuration's scale; see `Scene.gbuffer`."""
        return self._scene.gbuffer(scaled(camera, self.configuration.scale), rays=rays)

    def prepare(self, number: int, frame: Frame, gbuffer: GBuffer) -> LitFrame:
        """All that the refinement of the `number`-th frame of a run takes.

        Args:
            number: from 0.
            frame: of the scene.
            gbuffer: of its camera, see `FrameRelighter.gbuffer`.
        """
        scale, full = self.configuration.scale, None
        if scale == 1:
            view = view_of(frame, gbuffer)
        else:
            full = jax.device_put(frame.image)
            view = camera_view(downsample(full, scale), gbuffer, scaled(frame.camera, scale))
        view, shaded = self.shader(number, view, frame.camera)
        with self._clock("guide"):
            features = jax.block_until_ready(self._features(view))
        return LitFrame(view, shaded, features, full)

    def _features(self, view: View) -> Float[Array, "h w f"]:
        if self._carried is None:
            return self.guide.features(view.display)
        return self._carried.features(view, lambda: self.guide.features(view.display))

    def stages(self, number: int, frame: Frame, gbuffer: GBuffer) -> Iterator[tuple[str, Any]]:
        """The frame stage by stage, as `relight_stages`: the last result is `Relit`. Arguments: see `prepare`."""
        lit, own, remember = self.prepare(number, frame, gbuffer), self.configuration, None
        if self._video is not None:
            remember = self._video.filter(lit.view, self.shader.setup, lit.features, own.schedule)
        yield from refine(lit, own, temporal_filter=remember)

    def picture(self, number: int, frame: Frame) -> Float[Array, "h w 3"]:
        """Relit picture of a frame, linear; nothing to compare it with is made."""
        return refined_picture(self.prepare(number, frame, self.gbuffer(frame.camera)), self.configuration)


def scaled(camera: Camera, factor: int) -> Camera:
    """Camera of the picture whose pixels are cells of `factor` × `factor`."""
    k = camera.intrinsics
    height, width = level_shape((k.height, k.width), factor)
    parts = (each / factor for each in (k.fx, k.fy, k.cx, k.cy))
    return Camera(Intrinsics(width, height, *parts), camera.pose)
