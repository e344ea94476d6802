"""Workbench: a scene under lights with its accurate surface, where tuning cases come from."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.light.setup import LightSetup
from hyjax.scene.alignment import aligned
from hyjax.scene.place import view_of
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.scene.surfaces import rough_mesh
from hyjax.tuning.cases import Case, raw_filter, refined_filter
from hyjax.tuning.settings import CONVERGED, DIFFUSION_LIGHTS, TuneSettings
from hyjax.util.errors import InputError

CONVERGED_SCHEDULE = "naive-1000"
TARGET_VOXEL = 0.02


class Workbench:
    """A scene under lights, with the accurate surface that its pictures should look like.

    Args:
        scene: a capture on its rough mesh.
        accurate: the same capture on the mesh that the target is shaded from; None to aim at the converged
            diffusion on the rough one.
        lights: a set-up.
        guide: what makes the guide of a frame.
    """

    def __init__(self, scene: Scene, accurate: Scene | None, lights: LightSetup, guide: FrameGuide = RGB) -> None:
        self.scene, self.accurate, self.lights, self.guide = scene, accurate, lights, guide
        self._names: dict[int, str] = {}

    @property
    def description(self) -> str:
        """The two meshes in a few words, for the record."""
        return f"{self.scene.source} against {_source(self.accurate)}"

    def name(self, index: int) -> str:
        """Name of frame `index`, which is read once at most for it."""
        if index not in self._names:
            self._names[index] = self.scene.capture[index].name
        return self._names[index]

    def case(self, index: int) -> Case | None:
        """Frame `index` as a case; None if no ray meets the rough mesh or none meets the accurate one."""
        frame = self.scene.frame(index)
        self._names[index] = frame.name
        view = view_of(frame, self.scene.gbuffer(frame.camera))
        truth = None if self.accurate is None else self.accurate.gbuffer(frame.camera)
        if not bool(view.gbuffer.hit.any()) or (truth is not None and not bool(truth.hit.any())):
            return None
        shaded = view.shade(self.lights)
        case = Case(shaded, self.guide.features(view.display), view.frame, view.frame, view.gbuffer.hit)
        if truth is None:
            target = refined_filter(case, Schedule.preset(CONVERGED_SCHEDULE))
            return dataclasses.replace(case, target=target, valid=jnp.ones_like(case.valid))
        target = raw_filter(dataclasses.replace(view, gbuffer=truth).shade(self.lights))
        return dataclasses.replace(case, target=target, valid=truth.hit)

    def cases(self, indices: Sequence[int], what: str, progress: bool = True) -> tuple[list[Case], list[str]]:
        """The frames that make cases, and the names of those that see no surface.

        Raises:
            InputError: a frame cannot be read, or none sees any surface.
        """
        cases, blind = [], []
        for index in tqdm(indices, desc=f"{what} frames", unit="frame", disable=not progress):
            case = self.case(index)
            if case is None:
                blind.append(self.name(index))
            else:
                cases.append(case)
        shapes, name = {case.valid.shape for case in cases}, self.scene.capture.name
        if len(shapes) > 1:
            raise InputError(f"{name}: frames of different sizes, {sorted(shapes)}; give a --size")
        if not cases and indices:
            raise InputError(
                f"{name}: no ray of any of {len(indices)} {what} frames met the mesh; are the mesh and the poses "
                "in the same coordinates (metres, camera-to-world)?"
            )
        return cases, blind


def open_bench(
    settings: TuneSettings,
    *,
    capture: Capture | None = None,
    guide: FrameGuide = RGB,
) -> Workbench:
    """Workbench of a capture on disk, or of the built-in room.

    Args:
        settings: capture, meshes, lights and size.
        capture: frames that were opened before, in the place of those that the settings name.
        guide: what makes the guide of a frame.

    Raises:
        InputError: any of these cannot be used.
    """
    scene, accurate = open_scenes(settings.scene, settings.target, capture=capture, progress=not settings.quiet)
    return Workbench(scene, accurate, (accurate or scene).lights(settings.lights or DIFFUSION_LIGHTS), guide)


def open_scenes(
    settings: SceneSettings, target: str | None = None, *, capture: Capture | None = None, progress: bool = False
) -> tuple[Scene, Scene | None]:
    """A capture on its rough surface, and on an accurate one.

    Args:
        settings: capture, mesh and size.
        target: the accurate surface, see `TuneSettings`.
        capture: frames that were opened before.
        progress: show bars on stderr.

    Returns:
        The second is None where the target is the converged diffusion on the rough surface.
    """
    if capture is None:
        capture = settings.open_capture(progress=progress)
    if target is None:
        with_depth = "fused" if capture.reference() is None else "true"
        target = CONVERGED if not capture.depth_count else with_depth
    if target == "fused":  # whose poses both scenes must have
        capture = aligned(capture, settings.fusion, progress)
    rough = dataclasses.replace(settings, mesh=settings.mesh or rough_mesh(capture))
    scene, accurate = Scene.open(rough, capture=capture, progress=progress), None
    if target != CONVERGED:
        fusion = dataclasses.replace(settings.fusion, voxel=TARGET_VOXEL)
        better = dataclasses.replace(settings, mesh=target, fusion=fusion)
        accurate = Scene.open(better, capture=capture, progress=progress)
        if np.array_equal(scene.mesh.vertices, accurate.mesh.vertices):
            raise InputError(
                f"target: {accurate.source} is the rough mesh itself, which needs no repair; choose another"
            )
    return scene, accurate


def _source(accurate: Scene | None) -> str:
    return "1000 steps on the same mesh" if accurate is None else accurate.source
