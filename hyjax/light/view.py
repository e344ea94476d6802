"""View: a camera's picture, its visible surface, and its shading by lights."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.pyramid import downsample, level_shape
from hyjax.light.color import to_linear
from hyjax.light.emission import emission, may_show, upscaled_depth
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight, add_surface_light
from hyjax.light.setup import LightSetup, check_lights
from hyjax.light.shaded import Shaded
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import ShadowMap, visibilities
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import Run, call

USUAL_PIXELS = 640 * 480
"""Number of pixels of a usual picture; of four, nine, … times as many, sources are drawn at a half, a third, …"""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """Camera's picture with its visible surface.

    Attributes:
        frame: camera picture, linear.
        display: the same picture display-encoded, in [0, 1]: the "RGB guide".
        gbuffer: surface points seen by the camera.
        pose: camera-to-world; None if nothing follows from frame to frame.
        intrinsics: calibration matrix in pixels; None likewise.
        full: the picture at full size, display-encoded, where all else is at a whole part of it; None if it is not.
        full_frame: the same, linear, where it was made before; see `whole_frame`.
        factor: size of the full picture over that of the view (static).
    """

    frame: Float[Array, "h w 3"]
    display: Float[Array, "h w 3"]
    gbuffer: GBuffer
    pose: Float[ArrayLike, "4 4"] | None = None
    intrinsics: Float[ArrayLike, "3 3"] | None = None
    full: Float[Array, "fh fw 3"] | None = None
    full_frame: Float[Array, "fh fw 3"] | None = None
    factor: int = dataclasses.field(default=1, metadata={"static": True})

    @classmethod
    @checked_arguments(display=["display", "full"])
    def of(
        cls,
        display: Float[Array, "h w 3"],
        gbuffer: GBuffer,
        *,
        pose: Float[ArrayLike, "4 4"] | None = None,
        intrinsics: Float[ArrayLike, "3 3"] | None = None,
        full: Float[Array, "fh fw 3"] | None = None,
        factor: int | None = None,
        run: Run = call,
    ) -> "View":
        """View from a display-encoded picture.

        Args:
            display: camera picture, display-encoded; one of bytes is divided by 255.
            gbuffer: surface points seen by the camera, of the picture's size.
            pose: camera-to-world.
            intrinsics: calibration matrix in pixels.
            full: the picture at full size, likewise, where `display` is at a whole part of it: it is relit at full
                size, see `hyjax.light.relit`.
            factor: how many times larger `full` is; by default the least whole number that fits.
            run: runs the function that makes it linear.

        Raises:
            InputError: picture and G-buffer differ in size, or the full picture is not so many times larger.
        """
        if gbuffer.hit.shape != display.shape[:2]:
            raise InputError(f"view: display {display.shape[:2]} and gbuffer {gbuffer.hit.shape} differ in size")
        if full is None:
            return cls(run(to_linear, display), display, gbuffer, pose, intrinsics)
        (h, w, _), size = full.shape, display.shape[:2]
        times = max(1, -(-h // size[0]), -(-w // size[1])) if factor is None else factor
        if times < 1 or level_shape((h, w), times) != size:
            raise InputError(
                f"view: the display, {size}, must be the full picture, {(h, w)}, at a whole part of its size, such "
                f"as {level_shape((h, w), max(1, times))}"
            )
        view = cls(run(to_linear, display), display, gbuffer, pose, intrinsics, full, None, times)
        return dataclasses.replace(view, full_frame=view.whole_frame(run=run))

    @checked_arguments
    def shade(
        self,
        lights: LightSetup | Sequence[Light] | Light,
        *,
        shadow_maps: Sequence[ShadowMap | None] | None = None,
        confidence: Float[Array, "h w 1"] | None = None,
        surface_light: SurfaceLight | None = None,
        interleave: int = 1,
    ) -> Shaded:
        """Shade the visible surface by a set-up.

        Args:
            lights: a set-up, or lights (a single one, too) under the usual reference.
            shadow_maps: one for each light (None: casts no shadow); None for no shadows at all.
            confidence: how far the shading can be trusted, 1 by default, 0 in holes.
            surface_light: photo's own light and bounces, see `Scene.surface_light`; None for even light and none.
            interleave: the shadow views of a soft light with many are shared among blocks of so many by so many
                pixels, for what averages over such blocks anyway; see `hyjax.light.shadow_map.visibility`.

        Raises:
            InputError: no lights, a light with invalid values, another number of shadow maps than lights,
                a confidence of another size than the light's, or an interleave below 1.
        """
        *_, (_, shaded) = self.shade_stages(
            lights,
            shadow_maps=shadow_maps,
            confidence=confidence,
            surface_light=surface_light,
            interleave=interleave,
        )
        return shaded

    @checked_arguments
    def shade_stages(
        self,
        lights: LightSetup | Sequence[Light] | Light,
        *,
        shadow_maps: Sequence[ShadowMap | None] | None = None,
        confidence: Float[Array, "h w 1"] | None = None,
        surface_light: SurfaceLight | None = None,
        interleave: int = 1,
        run: Run = call,
    ) -> Iterator[tuple[str, Any]]:
        """Shade stage by stage: each stage's name with its result, the last one `Shaded`.

        Arguments and errors are those of `shade`; `run` runs the functions of the stages.
        """
        setup = LightSetup.of(lights)
        check_lights(setup.lights)
        if interleave < 1:
            raise InputError(f"interleave: must be a whole number of 1 or more, got {interleave}")
        maps = (None,) * len(setup.lights) if shadow_maps is None else tuple(shadow_maps)
        if len(maps) != len(setup.lights):
            raise InputError(
                f"shade: {len(maps)} shadow maps for {len(setup.lights)} lights; give one each, or None"
            )
        illuminance = run(shade_each, self.gbuffer, setup.lights)
        yield "shading", illuminance
        visibility = visibilities(self.gbuffer, setup.lights, maps, interleave=interleave, run=run)
        yield "visibility", visibility
        channels = setup, illuminance, visibility, self.gbuffer.hit
        if confidence is None:
            shaded = run(Shaded.of, *channels)
        else:
            shaded = Shaded.of(*channels, confidence=confidence)
        if surface_light is not None:
            shaded = self.add_surface_light(shaded, surface_light, setup.lights, run=run)
        yield "shaded", shaded

    def add_surface_light(
        self, shaded: Shaded, light: SurfaceLight, lights: Sequence[Light], *, run: Run = call
    ) -> Shaded:
        """Add the photo's own light, bounces and emission to a shaded surface.

        Args:
            shaded: direct light.
            light: on the vertices of the scan.
            lights: of the shading.
            run: runs the functions.

        Raises:
            InputError: the G-buffer has no triangles.
        """
        shaded = run(add_surface_light, shaded, dataclasses.replace(light, emitters=None), self.gbuffer, lights)
        if light.emitters is None or self.pose is None or self.intrinsics is None:
            return shaded
        h, w = self.gbuffer.hit.shape
        if not may_show(light.emitters, (h, w), self.pose, self.intrinsics):
            return shaded
        emitting = run(emission, light.emitters, self.source_frame(run=run), *self.source_surface(run=run))
        return dataclasses.replace(shaded, emission=emitting)

    def whole_frame(self, *, run: Run = call) -> Float[Array, "fh fw 3"]:
        """Picture at full size, linear."""
        if self.full is None or self.factor == 1:
            return self.frame
        return run(to_linear, self.full) if self.full_frame is None else self.full_frame

    @property
    def source_factor(self) -> int:
        """Factor by which the full picture is larger than that in which sources are drawn: 1 for a usual one."""
        if self.full is None:
            return 1
        most = max(1, math.isqrt(self.full.shape[0] * self.full.shape[1] // USUAL_PIXELS))
        return max(k for k in range(1, most + 1) if self.factor % k == 0)

    def source_frame(self, *, run: Run = call) -> Float[Array, "sh sw 3"]:
        """Picture in which sources are drawn, linear."""
        if self.full is None or self.source_factor == self.factor:
            return self.frame
        if self.source_factor == 1:
            return self.whole_frame(run=run)
        return run(to_linear, self._source_display(self.full, run))

    def source_surface(
        self, *, run: Run = call
    ) -> tuple[Float[Array, "sh sw"], Float[Array, "4 4"], Float[Array, "3 3"]]:
        """Depth in that picture, infinite in holes; the camera's pose, and its intrinsics there."""
        pose, matrix = jnp.asarray(self.pose, jnp.float32), jnp.asarray(self.intrinsics, jnp.float32)
        if self.full is None or self.source_factor == self.factor:
            return self.gbuffer.open_depth, pose, matrix
        picture, factor = self._source_display(self.full, run), self.factor // self.source_factor
        depth = run(upscaled_depth, self.gbuffer, picture, self.display, factor=factor)
        return depth, pose, matrix * np.array([[factor], [factor], [1]], np.float32)

    def _source_display(self, full: Float[Array, "fh fw 3"], run: Run) -> Float[Array, "sh sw 3"]:
        """Picture in which sources are drawn, display-encoded: a usual one as it is."""
        return full if self.source_factor == 1 else run(downsample, full, factor=self.source_factor)
