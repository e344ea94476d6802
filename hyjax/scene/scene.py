"""Scene: a capture with its surface, from which views and the light on them come."""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from hyjax.configuration import Configuration, LightOptions
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import is_light_file, read_lights
from hyjax.geometry.camera import Camera
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.photo_light import SurfaceLight
from hyjax.light.relit import Relit
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.scene.fusion_settings import FUSED
from hyjax.scene.kept_maps import KeptMaps, Maps
from hyjax.scene.light_places import LightAnchors, survey_capture
from hyjax.scene.light_setups import check_setup_name, named_setup, placed_setup
from hyjax.scene.occluders import completed, fine_detail
from hyjax.scene.photo_light import ScenePhotoLight
from hyjax.scene.place import AnyLights, view_of
from hyjax.scene.relighter import Relighter
from hyjax.scene.settings import Occluders, SceneSettings, parse_size
from hyjax.scene.surfaces import SURFACE_ERROR, surface_arrays, will_fuse
from hyjax.util.arguments import checked_arguments
from hyjax.util.cache import cache_folder
from hyjax.util.clock import StageClock
from hyjax.util.errors import InputError

if TYPE_CHECKING:
    import trimesh

UNIT_TOLERANCE = 1e-3
AnyConfiguration = Configuration | Schedule | str | Path | None


class Scene:
    """A capture with its surface: frames, their views, and the light in them.

    `settings` are those that it was opened by; None if it was made otherwise.

    Example:
        scene = Scene.open(SceneSettings(capture=Path("my_scan"), size="640x480"))
        relit = scene.relit(0, "evening-lamps", "fast")
        hyjax.write_png(Path("relit.png"), hyjax.to_display(relit.image))

    Args:
        capture: frames with poses.
        mesh: surface in the capture's world coordinates.
        size: (height, width) to work at; None as captured.
        source: the mesh in a few words, for the record.
        slack: metres that the mesh may be wrong by (see `ShadowMap`); None for one that is accurate and has no
            holes, so that it throws its shadows as it is.
        detail: makes, when first needed, a finer surface that throws shadows, too; None for none.
        photo_sources: file that names the windows and lamps that lit the frames; None to find them.
        progress: show bars on stderr.

    Raises:
        InputError: the capture has no frames, or no unit vector against gravity.
    """

    @checked_arguments
    def __init__(
        self,
        capture: Capture,
        mesh: "trimesh.Trimesh | MeshArrays",
        *,
        size: tuple[int, int] | None = None,
        source: str = "mesh",
        slack: float | None = SURFACE_ERROR,
        detail: "Callable[[], trimesh.Trimesh | MeshArrays | None]" = lambda: None,
        photo_sources: Path | None = None,
        progress: bool = False,
    ) -> None:
        if not len(capture):
            raise InputError(f"{capture.name}: the capture has no frames")
        if np.shape(capture.up) != (3,) or abs(np.linalg.norm(capture.up) - 1.0) > UNIT_TOLERANCE:
            raise InputError(f"{capture.name}: 'up' must be a unit vector of three numbers, got {capture.up!r}")
        if slack is not None and not 0.0 <= slack < np.inf:
            raise InputError(f"slack: must be metres, 0 or more, or None for an exact mesh, got {slack!r}")
        self.capture, self.size, self.source, self._sources_file = capture, size, source, photo_sources
        self.caster = RayCaster(mesh)
        self._anchors: dict[bool, LightAnchors] = {}
        self.slack, self._detail = slack, detail
        self.kept_maps, self.maps_on_disk, self._progress = KeptMaps(), True, progress
        self.settings: SceneSettings | None = None

    @classmethod
    @checked_arguments
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
        settings, clock, given = settings.check(), clock or StageClock(), capture is not None
        if capture is None:
            with clock("capture"):
                capture = settings.open_capture(progress=progress)
        with clock("mesh"):
            tracked = capture
            if fuses := will_fuse(capture, settings.mesh, settings.fusion):
                from hyjax.scene.alignment import AlignedCapture, aligned  # slow to load

                capture = aligned(capture, settings.fusion, progress)
            source, mesh, slack = surface_arrays(
                capture,
                settings.mesh,
                fusion=settings.fusion,
                seed=settings.seed,
                repair=settings.repair_mesh,
                progress=progress,
                tracked=tracked,
            )
            if fuses and not source.startswith(FUSED):
                capture = tracked
            if fuses and isinstance(capture, AlignedCapture):
                source += f", poses aligned ({1000 * float(np.median(capture.moved)):.0f} mm, median)"

            def detail() -> MeshArrays | None:
                made = "fused" if source.startswith(FUSED) else settings.mesh
                return fine_detail(capture, made, settings.seed, progress)

            scene = cls(
                capture,
                mesh,
                size=parse_size(settings.size),
                source=source,
                slack=slack,
                detail=detail,
                photo_sources=settings.photo_sources,
                progress=progress,
            )
            scene.settings = None if given else settings
            return scene

    def __len__(self) -> int:
        return len(self.capture)

    @property
    def mesh(self) -> "trimesh.Trimesh":
        """The surface."""
        return self.caster.mesh

    @property
    def revision(self) -> int:
        """Number of the surface, which stays."""
        return 0

    @property
    def knows_photo_light(self) -> bool:
        """Whether the light that the frames were taken under can be divided out."""
        return True

    @checked_arguments
    def frame(self, index: int | Frame) -> Frame:
        """Frame of the capture, at the size that is worked at; any other as it is.

        Raises:
            InputError: there is none at this position, or it cannot be read.
        """
        if isinstance(index, Frame):
            return index
        if not -len(self) <= index < len(self):
            raise InputError(f"frame {index}: the capture has frames 0 to {len(self) - 1}")
        return fit(self.capture.picture(index), self.size)

    @checked_arguments
    def gbuffer(self, camera: Camera, *, rays: bool = False) -> GBuffer:
        """Surface points seen by a camera; by single rays, if so, which is sooner for a picture or two."""
        return self.caster.gbuffer_by_rays(camera) if rays else self.caster.gbuffer(camera)

    @checked_arguments
    def view(self, index: int | Frame) -> View:
        """View of a frame: its picture, and the surface in it.

        Raises:
            InputError: the frame cannot be read.
        """
        frame = self.frame(index)
        return view_of(frame, self.gbuffer(frame.camera))

    @checked_arguments
    def lights(self, lights: AnyLights, *, at_photo_sources: bool = False, exposed: bool = True) -> LightSetup:
        """Light set-up by name, placed in this room, or from a YAML or JSON file; a set-up or lights as they are.

        Args:
            at_photo_sources: whether a named set-up is exposed for frames divided by their own light, and shines
                through the windows and from the lamps that lit them, where a file names them or the capture none.
            exposed: whether a named set-up is exposed; else its lights have their places, not their strengths.

        Raises:
            InputError: no such set-up, or the file cannot be used.
        """
        if not isinstance(lights, str | Path):
            return LightSetup.of(lights)
        name = str(lights)
        if is_light_file(name):
            return read_lights(Path(name), self.capture.up)
        check_setup_name(name)
        anchors = self.anchors(at_photo_sources=at_photo_sources)
        if not exposed:
            return placed_setup(name, anchors)
        photo = self.photo_light.estimate.light if at_photo_sources else None
        return named_setup(name, anchors, photo)

    def anchors(self, *, at_photo_sources: bool = False) -> LightAnchors:
        """Places of the lights of named set-ups, found once. Argument: see `lights`."""
        found = at_photo_sources and (self._sources_file is not None or not self.capture.anchors)
        if found not in self._anchors:
            known = self.photo_light.sources.anchors if found else None
            self._anchors[found] = survey_capture(self.caster, self.capture, known)
        return self._anchors[found]

    @functools.cached_property
    def occluders(self) -> RayCaster:
        """The mesh that throws shadows: the surface, completed unless it is exact."""
        if self.slack is None:
            return self.caster
        detail = self._detail()
        return RayCaster(completed(self.caster.arrays, None if detail is None else MeshArrays.of(detail)))

    @checked_arguments
    def shadow_maps(
        self,
        lights: LightSetup | Sequence[Light],
        *,
        occluders: Occluders = "completed",
        scale: float = 1.0,
        most_views: int | None = None,
    ) -> Maps:
        """Shadow maps of lights; those of the last are kept. Arguments: see `Place`."""

        def cast(lights: Sequence[Light]) -> Maps:
            caster, slack = (self.occluders, self.slack) if occluders == "completed" else (self.caster, None)
            folder = cache_folder() / "shadow-maps" if self.maps_on_disk else None
            return jax.block_until_ready(cast_shadow_maps(caster, lights, scale, slack, most_views, folder=folder))

        return self.kept_maps.of((occluders, scale, most_views), LightSetup.of(lights).lights, cast)

    @checked_arguments
    def shade(
        self,
        view: View,
        lights: AnyLights,
        *,
        shadows: bool = True,
        keep_photo_light: bool = False,
        occluders: Occluders = "completed",
    ) -> Shaded:
        """Light on the surface in a view.

        Args:
            view: of this scene.
            lights: lights, a set-up, or its name or file, see `lights`.
            shadows: whether lights cast shadows.
            keep_photo_light: whether to leave the light that the frames were taken under, and bounces out.
            occluders: what throws them.

        Raises:
            InputError: no such set-up, or it keeps sources of a photo whose light is kept whole.
        """
        configuration = Configuration(light=LightOptions(photo_light="kept" if keep_photo_light else "divided"))
        relighter = Relighter(self, lights, configuration, shadows=shadows, occluders=occluders)
        return relighter.shade(view)

    @checked_arguments
    def relit(self, frame: int | Frame, lights: AnyLights, configuration: AnyConfiguration = None) -> Relit:
        """Relit frame; for many of them keep a `Relighter`.

        Args:
            frame: its position, or any frame with a camera.
            lights: lights, a set-up, or its name or file, see `lights`.
            configuration: a configuration, its name or file, or a schedule for the default one; None for that one.

        Raises:
            InputError: any of these cannot be used.
        """
        return Relighter(self, lights, configuration).relit(frame, rays=True)  # a single picture

    def explore(
        self, *, frame: int = 0, lights: AnyLights = "evening-lamps", configuration: AnyConfiguration = None
    ) -> Any:
        """Widget of a notebook that relights the frames by hand; see `hyjax.explore`."""
        from hyjax import explore

        return explore(self, frame=frame, lights=lights, configuration=configuration)

    @functools.cached_property
    def photo_light(self) -> ScenePhotoLight:
        """Light that the frames were taken under, estimated when first asked for and kept in the cache folder."""
        return ScenePhotoLight(
            self.capture,
            self.caster,
            size=self.size,
            sources_file=self._sources_file,
            progress=self._progress,
        )

    @checked_arguments
    def surface_light(
        self, lights: LightSetup | Sequence[Light], *, shadows: bool = True, occluders: Occluders = "completed"
    ) -> SurfaceLight:
        """Photo's own light and the bounces of new lights, on the vertices; those of the last lights are kept.

        Where the photo's light could not be told, the frames are taken to be evenly lit.

        Args:
            lights: new lights.
            shadows: whether they cast shadows.
            occluders: what throws them.

        Raises:
            InputError: the file of the photo's sources cannot be used.
        """
        setup = LightSetup.of(lights)
        maps = self.shadow_maps(setup, occluders=occluders) if shadows else None
        return self.photo_light.surface_light(setup, maps)
