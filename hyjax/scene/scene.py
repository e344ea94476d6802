"""Scene: a capture with its surface, from which views and the light on them come."""

import functools
import hashlib
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Array, Float

from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit, spread
from hyjax.data.light_file import is_light_file, read_lights
from hyjax.data.registry import open_capture
from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.emission import Emitters, radiant_filter
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight, bounced_light
from hyjax.light.setup import LightSetup, same_lights
from hyjax.light.shaded import Shaded
from hyjax.light.shadow_map import ShadowMap
from hyjax.light.view import View
from hyjax.photo_light.estimate import Estimate, estimate_arrays, read_estimate
from hyjax.photo_light.source_search import find_photo_sources
from hyjax.photo_light.sources import PhotoSources
from hyjax.scene.light_setups import LightAnchors, check_setup_name, named_setup, survey_capture
from hyjax.scene.settings import SceneSettings, parse_size
from hyjax.scene.surfaces import surface_of
from hyjax.util.cache import cache_folder, cached_arrays
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError
from hyjax.util.files import digest

UNIT_TOLERANCE = 1e-3
PHOTO_FRAMES = 24
"""Frames, spread over the capture, that the photo's light is estimated from."""
PHOTO_WIDTH = 800
"""Pixels of their longer side, at most."""
PHOTO_VERSION = 1
"""Of that estimate. Add one whenever it comes out differently."""


class Scene:
    """A capture with its surface: frames, what their cameras see, and the light on it.

    Example:
        scene = Scene.open(SceneSettings(capture=Path("my_scan"), size="640x480"))
        view = scene.view(0)
        shaded = scene.shade(view, "evening-lamps")
        relit = hyjax.relight(view, shaded, view.display, hyjax.Schedule.preset("hyjax"))
        hyjax.write_png(Path("relit.png"), hyjax.to_display(relit.image))

    Args:
        capture: frames with poses.
        mesh: surface in the capture's world coordinates.
        size: (height, width) to work at; None as captured.
        source: the mesh in a few words, for the record.
        photo_sources: file that names the windows and lamps that lit the frames; None to find them.
        progress: show bars on stderr.

    Raises:
        InputError: the capture has no frames, or no unit vector against gravity.
    """

    def __init__(
        self,
        capture: Capture,
        mesh: trimesh.Trimesh,
        *,
        size: tuple[int, int] | None = None,
        source: str = "mesh",
        photo_sources: Path | None = None,
        progress: bool = False,
    ) -> None:
        if not len(capture):
            raise InputError(f"{capture.name}: the capture has no frames")
        if np.shape(capture.up) != (3,) or abs(np.linalg.norm(capture.up) - 1.0) > UNIT_TOLERANCE:
            raise InputError(f"{capture.name}: 'up' must be a unit vector of three numbers, got {capture.up!r}")
        self.capture, self.size, self.source = capture, size, source
        self.caster = RayCaster(mesh)
        self._anchors: LightAnchors | None = None
        self._maps: tuple[tuple[Light, ...], tuple[ShadowMap | None, ...]] | None = None
        self._surface_light: tuple[tuple[tuple[Light, ...], bool, float], SurfaceLight] | None = None
        self.progress, self._sources_file = progress, photo_sources

    @classmethod
    def open(
        cls,
        settings: SceneSettings,
        *,
        capture: Capture | None = None,
        clock: StageClock | None = None,
        progress: bool = False,
    ) -> "Scene":
        """Scene of a capture on disk, or of the built-in room.

        Args:
            settings: capture, surface and size.
            capture: frames that were opened before, in the place of those that the settings name.
            clock: takes the times of the stages `capture` and `mesh`.
            progress: show bars on stderr.

        Raises:
            InputError: any of these cannot be used.
        """
        settings, clock = settings.check(), clock or StageClock()
        if capture is None:
            with clock("capture"):
                capture = open_capture(settings.capture, progress)
        with clock("mesh"):
            source, mesh = surface_of(
                capture,
                settings.mesh,
                voxel=settings.voxel,
                seed=settings.seed,
                repair=settings.repair_mesh,
                progress=progress,
            )
            return cls(
                capture,
                mesh,
                size=parse_size(settings.size),
                source=source,
                photo_sources=settings.photo_sources,
                progress=progress,
            )

    def __len__(self) -> int:
        return len(self.capture)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The surface."""
        return self.caster.mesh

    def frame(self, index: int) -> Frame:
        """Frame of the capture, at the size that is worked at.

        Raises:
            InputError: there is none at this position, or it cannot be read.
        """
        if not -len(self) <= index < len(self):
            raise InputError(f"frame {index}: the capture has frames 0 to {len(self) - 1}")
        return fit(self.capture[index], self.size)

    def gbuffer(self, camera: Camera) -> GBuffer:
        """Surface points seen by a camera."""
        return self.caster.gbuffer(camera)

    def view(self, index: int) -> View:
        """View of a frame: its picture, and the surface in it.

        Raises:
            InputError: the frame cannot be read.
        """
        frame = self.frame(index)
        return view_of(frame, self.gbuffer(frame.camera))

    def lights(self, lights: LightSetup | Sequence[Light] | str | Path) -> LightSetup:
        """Light set-up by name, placed in this room, or from a YAML or JSON file; a set-up or lights as they are.

        Raises:
            InputError: no such set-up, or the file cannot be used.
        """
        if not isinstance(lights, str | Path):
            return LightSetup.of(lights)
        name = str(lights)
        if is_light_file(name):
            return read_lights(Path(name), self.capture.up)
        check_setup_name(name)
        if self._anchors is None:
            self._anchors = survey_capture(self.caster, self.capture)
        return named_setup(name, self._anchors)

    def shadow_maps(self, lights: LightSetup | Sequence[Light]) -> tuple[ShadowMap | None, ...]:
        """Shadow maps of lights; those of the last lights are kept."""
        own = LightSetup.of(lights).lights
        if self._maps is None or not same_lights(self._maps[0], own):
            self._maps = own, jax.block_until_ready(cast_shadow_maps(self.caster, own))
        return self._maps[1]

    def shade(
        self,
        view: View,
        lights: LightSetup | Sequence[Light] | str | Path,
        *,
        shadows: bool = True,
        keep_photo_light: bool = False,
    ) -> Shaded:
        """Light on what a view sees.

        Args:
            view: of this scene.
            lights: lights, a set-up, or its name or file, see `lights`.
            shadows: whether lights cast shadows.
            keep_photo_light: whether to leave the light that the frames were taken under, and bounces out.

        Raises:
            InputError: no such set-up.
        """
        setup = self.lights(lights)
        light = None if keep_photo_light else self.surface_light(setup, shadows=shadows)
        return view.shade(setup, shadow_maps=self.shadow_maps(setup) if shadows else None, surface_light=light)

    @functools.cached_property
    def photo_light(self) -> Estimate:
        """Light that the frames were taken under, estimated when first asked for and kept in the cache folder."""
        mesh = (np.ascontiguousarray(part).tobytes() for part in (self.mesh.vertices, self.mesh.faces))
        sources = self.photo_sources
        named = repr([(w.name, w.corners.round(4).tolist()) for w in sources.windows])
        named += repr([(lamp.name, lamp.position.round(4).tolist()) for lamp in sources.lamps])
        key = digest([self.capture.fingerprint, str(self.size), named, hashlib.sha256(b"".join(mesh)).hexdigest()])
        return cached_arrays(
            cache_folder() / f"photo-light-v{PHOTO_VERSION}-{key}.npz",
            lambda arrays: read_estimate(self.caster, arrays),
            lambda: estimate_arrays(
                self.caster, self._photos, np.asarray(self.capture.up, np.float64), sources, self.progress
            ),
        )

    def _emitters(self, setup: LightSetup, mean: Float[Array, "3"]) -> Emitters | None:
        """Panes and lamps with what they send under new lights; None if there are none."""
        sources = self.photo_sources
        if not sources.windows and not sources.lamps:
            return None
        panes = np.array([(w.center, w.right, w.up) for w in sources.windows]).reshape(-1, 3, 3)
        lamps = np.array([(*lamp.position, lamp.radius) for lamp in sources.lamps]).reshape(-1, 4)
        sent = radiant_filter(setup.lights, panes, lamps, float(setup.reference_lux))
        own, bulbs, light = (jnp.asarray(a, jnp.float32) for a in (panes, lamps, sent))
        return Emitters(own, bulbs, light, mean)

    @functools.cached_property
    def photo_sources(self) -> PhotoSources:
        """Windows and lamps that lit the frames.

        Raises:
            InputError: the file of `SceneSettings.photo_sources` cannot be used.
        """
        return find_photo_sources(self.capture, self.caster, self._photos, file=self._sources_file)

    @functools.cached_property
    def _photos(self) -> list[Frame]:
        """Frames spread over the capture, no larger than needed, that tell of the light they were taken under."""
        frames = []
        for index in spread(range(len(self)), PHOTO_FRAMES):
            frame = self.frame(index)
            height, width = frame.camera.intrinsics.shape
            share = min(1.0, PHOTO_WIDTH / max(height, width))
            frames.append(fit(frame, (round(height * share), round(width * share))) if share < 1 else frame)
        return frames

    def surface_light(self, lights: LightSetup | Sequence[Light], *, shadows: bool = True) -> SurfaceLight:
        """Photo's own light and the bounces of new lights, on the vertices; those of the last lights are kept."""
        setup = LightSetup.of(lights)
        key = (setup.lights, shadows, setup.reference_lux)
        if self._surface_light is None or not _same_key(self._surface_light[0], key):
            photo = self.photo_light.light
            bounced = bounced_light(photo, setup.lights, self.shadow_maps(setup) if shadows else None)
            emitters = self._emitters(setup, photo.mean)
            self._surface_light = key, SurfaceLight(photo.illuminance, bounced, photo.transport.faces, emitters)
        return self._surface_light[1]


def _same_key(a: tuple[tuple[Light, ...], bool, float], b: tuple[tuple[Light, ...], bool, float]) -> bool:
    return a[1:] == b[1:] and same_lights(a[0], b[0])


def view_of(frame: Frame, gbuffer: GBuffer) -> View:
    """View of a frame whose G-buffer was cast before."""
    pose, intrinsics = (
        np.asarray(matrix, np.float32) for matrix in (frame.camera.pose, frame.camera.intrinsics.matrix)
    )
    return View.of(jnp.asarray(frame.image), gbuffer, pose=pose, intrinsics=intrinsics)
