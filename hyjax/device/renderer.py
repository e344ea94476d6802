"""Renderer of a scene's frames on a graphics processor, by the shaders of an exported page."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hyjax.configuration import LightOptions
from hyjax.core.schedule import Schedule
from hyjax.device.frame_program import MOST_EMITTERS, frame_program
from hyjax.device.light_records import LightRecords, light_records
from hyjax.device.program import Precision, Program
from hyjax.device.scene_arrays import scene_arrays
from hyjax.device.webgpu import ShaderEngine, open_device
from hyjax.geometry.camera import Camera
from hyjax.light.color import to_linear
from hyjax.light.emission import Emitters
from hyjax.light.panes import MOST_BARS, NO_BAR, Bars
from hyjax.light.photo_light import least_bounced
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import ambient_filter
from hyjax.scene.scene import Scene
from hyjax.scene.settings import Occluders
from hyjax.util.errors import InputError


class DeviceRenderer:
    """Renderer that relights frames of a scene under one set-up on a graphics processor.

    Args:
        scene: opened.
        setup: the lights.
        size: (height, width) of the frames.
        schedule: cascade for the light.
        shadow_schedule: cascade for the visibility; by default that of `relight`.
        features: channels of the guide.
        shadows: whether lights cast shadows.
        light: whether the photo's own light stays in the picture, and bounces out; exponent of it.
        occluders: meshes that cast shadows.
        resolutions: texels a side of shadow maps with one view, and of each of several.
        precision: of pictures between passes.
        device: see `open_device`.

    Raises:
        InputError: no device, a kind of light without a shader, or too many of them.
    """

    def __init__(
        self,
        scene: Scene,
        setup: LightSetup,
        size: tuple[int, int],
        schedule: Schedule,
        shadow_schedule: Schedule | None = None,
        *,
        features: int = 3,
        shadows: bool = True,
        light: LightOptions | None = None,
        occluders: Occluders = "completed",
        resolutions: tuple[int, int] = (1024, 512),
        precision: Precision = "f32",
        device: Any = None,
    ) -> None:
        light = light or LightOptions()
        keep_photo_light = light.photo_light == "kept"
        self.arrays = scene_arrays(
            scene,
            keep_photo_light=keep_photo_light,
            surface_occluders=occluders == "surface",
            photo_exponent=light.photo_exponent,
        )
        self.setup, self._divides, self._features = setup, not keep_photo_light, features
        caster = scene.caster if occluders == "surface" else scene.occluders
        slack = scene.slack if occluders == "completed" else None
        # Light that falls on any surface alike is left out where bounces stand in for it.
        uniform = keep_photo_light or all(light.UNIFORM for light in setup.lights)
        self.records = light_records(
            setup.lights, caster.mesh, shadows=shadows, slack=slack, resolutions=resolutions, uniform=uniform
        )
        shadow_schedule = shadow_schedule or Schedule.preset("hyjax-scan-shadow")
        self.program: Program = frame_program(
            self.arrays.counts,
            size,
            schedule,
            shadow_schedule,
            features=features,
            precision=precision,
        )
        sizes = {"depths": max(16, 4 * self.records.texels)}
        self.engine = ShaderEngine(self.program, len(setup.lights), sizes, device or open_device(precision))
        for name, values in self.arrays.uploads().items():
            self.engine.upload(name, values)
        self.emitters = scene.photo_light.emitters(setup) if self._divides else None
        self._upload_lights(scene, self.records)

    def _upload_lights(self, scene: Scene, records: LightRecords) -> None:
        engine = self.engine
        engine.upload("lights", records.records)
        engine.upload("views", records.views)
        if self._divides:
            kept = scene.photo_light.kept(self.setup.existing)
            least = least_bounced(self.setup.lights, scene.photo_light.estimate.light.filled_share)
            rows = np.vstack([kept.reshape(-1, 3), least / float(self.setup.reference_lux)])
            engine.upload("kept", np.pad(rows, ((0, 0), (0, 1))).astype(np.float32))
        if self.emitters is not None:
            engine.upload("emitters", emitter_vectors(self.emitters))
        engine.upload("frame", self._frame_record(None))
        engine.run("load")
        sizes = records.records["size"][records.jobs[:, 0]]
        for size in np.unique(sizes):
            jobs = records.jobs[sizes == size]
            engine.upload("jobs", jobs)
            engine.run("shadows", jobs=len(jobs), side=int(size) + 2)
        if self._divides:
            engine.run("bounces")

    def _frame_record(self, camera: Camera | None) -> np.ndarray:
        panes, lamps = (0, 0) if self.emitters is None else (len(self.emitters.panes), len(self.emitters.lamps))
        counts = len(self.setup.lights), panes, lamps
        ambient = np.asarray(ambient_filter(self.setup.lights, float(self.setup.reference_lux)))
        return frame_record(camera, counts, ambient, float(self.setup.reference_lux), self.arrays.mean)

    def relight(
        self, pixels: Float[np.ndarray, "h w 3"], camera: Camera, guide: Float[Array, "h w f"] | None = None
    ) -> Float[np.ndarray, "h w 3"]:
        """Relit picture, linear.

        Args:
            pixels: the frame, display-encoded, in [0, 1].
            camera: that took it.
            guide: features, where they are not the frame itself.
        """
        self.engine.upload("frame", self._frame_record(camera))
        self.engine.upload("picture", self._planes(pixels))
        if self._features != 3 and guide is not None:
            self.engine.upload("guide", self._planes(guide))
        self.engine.run("frame")
        return self._download("image")[0, ..., :3]

    def relit(self, pixels: Float[np.ndarray, "h w 3"], camera: Camera, guide: Float[Array, "h w f"]) -> Relit:
        """Relit picture with its stages; arguments as of `relight`.

        Emission of panes and lamps comes from the relit picture in `unrefined`, too.
        """
        image = self.relight(pixels, camera, guide)
        self.engine.run("refined", "stages")
        shading, refined, visibility, shadowed = self._download("stages")[..., :3]
        shining = self._download("image")[0, ..., 3:]
        plain = shadowed * np.asarray(to_linear(jnp.asarray(pixels)))
        unrefined = plain + shining * (image - plain)
        return Relit(*map(jnp.asarray, (shading, refined, visibility, refined * visibility, unrefined, image)))

    @property
    def sees_surface(self) -> bool:
        """Whether any pixel of the last frame shows the scan."""
        return bool(self.engine.download("cascade totals")[3] > 0)

    def _download(self, name: str) -> Float[np.ndarray, "n h w 4"]:
        return self.engine.download(name).reshape(-1, *self.program.size, 4)

    def picture(self, name: str, channels: int) -> Float[np.ndarray, "h w c"]:
        """A stage of the last frame: `raw`, `refined` or `visibility`."""
        dtype = np.float16 if self.program.precision == "f16" else np.float32
        planes = self.engine.download(self.program.names[name], dtype).reshape(-1, *self.program.size, 4)
        return np.moveaxis(planes, 0, 2).reshape(*self.program.size, -1)[..., :channels].astype(np.float32)

    def _planes(self, values: ArrayLike) -> np.ndarray:
        return channel_groups(np.asarray(values, np.float32)).astype(
            np.float16 if self.program.precision == "f16" else np.float32
        )


def channel_groups(values: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "g h w 4"]:
    """Groups of four channels of a picture, the last one padded with zeros."""
    height, width, channels = values.shape
    groups = -(-channels // 4)
    padded = np.zeros((height, width, 4 * groups), values.dtype)
    padded[..., :channels] = values
    return np.ascontiguousarray(np.moveaxis(padded.reshape(height, width, groups, 4), 2, 0))


def frame_record(
    camera: Camera | None,
    counts: Sequence[int],
    ambient: Float[np.ndarray, "3"],
    reference_lux: float,
    mean: Float[np.ndarray, "3"],
) -> np.ndarray:
    """Record `struct Frame` of `wgsl/frame.wgsl`.

    Args:
        camera: None where only the lights matter.
    """
    record = np.zeros(32, np.float32)
    if camera is not None:
        for k in range(3):
            record[4 * k : 4 * k + 3] = camera.pose[:3, k]
        intrinsics = camera.intrinsics
        record[12:15], record[16:20] = camera.origin, (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    record[20:24] = np.array([*counts, 0], np.uint32).view(np.float32)
    record[24:28] = (*ambient, 1.0 / reference_lux)
    record[28:31] = mean
    return record


def bar_vectors(bars: Bars, number: int) -> Float[np.ndarray, "b 4"]:
    """Bars of a pane: middle and half width of one along the axis to the right, and of one along the axis up.

    The last vector begins with the distance of all behind the pane.
    """
    spans = np.concatenate(np.asarray(bars.spans)[number], axis=-1)
    spans = np.concatenate([spans, np.tile([0.0, NO_BAR], (MOST_BARS - len(spans), 2))])
    return np.stack([*spans, np.array([np.asarray(bars.recess)[number], 0, 0, 0])])


def emitter_vectors(emitters: Emitters) -> Float[np.ndarray, "n 4"]:
    """Vectors of panes and lamps for `wgsl/composite.wgsl`."""
    panes, lamps = np.asarray(emitters.panes), np.asarray(emitters.lamps)
    if len(panes) + len(lamps) > MOST_EMITTERS:
        raise InputError(f"webgpu: {len(panes) + len(lamps)} windows and lamps; at most {MOST_EMITTERS}")
    rows: list[np.ndarray] = []
    sent, kept = np.asarray(emitters.sent), np.asarray(emitters.kept)
    for number, pane in enumerate(panes):
        rows += [*pane, sent[number], kept[number], np.asarray(emitters.pane_means)[number]]
        rows += [*bar_vectors(emitters.bars, number)]
    for number, lamp in enumerate(lamps, len(panes)):
        rows += [lamp, sent[number], kept[number]]
    return np.stack([np.pad(np.asarray(row, np.float32), (0, 4 - len(row))) for row in rows])
