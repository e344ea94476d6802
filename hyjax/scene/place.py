"""Place: frames and the surface that they show, as a relighter needs them; and views of its frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import jax
import numpy as np
from jaxtyping import Array, Float

from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.setup import LightSetup
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.scene.settings import Occluders
from hyjax.util.programs import run_kept

AnyLights = LightSetup | Sequence[Light] | str | Path
"""A set-up, lights, or the name or file of a set-up."""


class Place(Protocol):
    """Frames and the surface that they show: a `Scene`, a growing `LiveScene`, or a tour's `Arrangement`."""

    @property
    def revision(self) -> int | None:
        """Number of the surface, which grows when it changes; None before there is any."""
        ...

    @property
    def knows_photo_light(self) -> bool:
        """Whether the light that the frames were taken under can be divided out."""
        ...

    @property
    def caster(self) -> RayCaster:
        """The surface."""
        ...

    def frame(self, index: int | Frame) -> Frame:
        """Frame by its position, or any other, at the size that is worked at."""
        ...

    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface points seen by a camera."""
        ...

    def lights(self, lights: AnyLights, *, at_photo_sources: bool = False) -> LightSetup:
        """Light set-up in this place."""
        ...

    def shadow_maps(
        self,
        lights: LightSetup | Sequence[Light],
        *,
        occluders: Occluders = "completed",
        scale: float = 1.0,
        most_views: int | None = None,
    ) -> tuple[ShadowMap | None, ...]:
        """Shadow maps of lights on the surface as it is now.

        Args:
            lights: a set-up, or lights.
            occluders: what throws the shadows.
            scale, most_views: see `cast_shadow_maps`.
        """
        ...

    def surface_light(
        self,
        lights: LightSetup | Sequence[Light],
        *,
        shadows: bool = True,
        occluders: Occluders = "completed",
    ) -> SurfaceLight:
        """Photo's own light and the bounces of new lights; asked only where the photo's light is known."""
        ...


def view_of(frame: Frame, gbuffer: GBuffer) -> View:
    """View of a frame whose G-buffer was cast before."""
    return camera_view(jax.device_put(frame.image), gbuffer, frame.camera)


def camera_view(
    display: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    camera: Camera,
    full: Float[Array, "fh fw 3"] | None = None,
    factor: int | None = None,
) -> View:
    """View of a display-encoded picture of a camera, see `View.of`."""
    pose, intrinsics = (np.asarray(matrix, np.float32) for matrix in (camera.pose, camera.intrinsics.matrix))
    return View.of(display, gbuffer, pose=pose, intrinsics=intrinsics, full=full, factor=factor, run=run_kept)
