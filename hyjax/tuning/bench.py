"""A capture under lights, on a rough mesh and on an accurate one: where tuning cases come from."""

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import trimesh
from tqdm import tqdm

from hyjax.color import to_linear
from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import fit
from hyjax.data.light_file import LightSetup, is_light_file, read_lights
from hyjax.data.light_setups import check_setup_name, named_setup, survey_capture
from hyjax.data.open import open_capture
from hyjax.data.room import RoomCapture, load_room
from hyjax.data.surfaces import check_mesh_name, rough_mesh, surface_of
from hyjax.errors import InputError
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.refine import cascade_known
from hyjax.scene.raycast import RayCaster
from hyjax.schedule import Schedule
from hyjax.shading import colored, shade_each
from hyjax.tuning.cases import Case, mix

CONVERGED = "converged"
"""The target where there is no better mesh: what the paper's cascade approximates."""
CONVERGED_SCHEDULE = "naive-1000"
TARGET_VOXEL = 0.02


class Workbench:
    """A capture under lights, on a rough mesh and on an accurate one.

    Args:
        capture: frames with poses.
        rough: the mesh that has to be made do with.
        accurate: the mesh that the target is shaded from; None to aim at the converged diffusion of the rough one.
        setup: lights.
        size: (height, width) to work at; None as captured.
        description: the two meshes in a few words, for the record.
        guide: what makes the guide of a frame.
    """

    def __init__(
        self,
        capture: Capture,
        rough: trimesh.Trimesh,
        accurate: trimesh.Trimesh | None,
        setup: LightSetup,
        size: tuple[int, int] | None = (512, 512),
        description: str = "",
        guide: FrameGuide = RGB,
    ) -> None:
        self.description, self.guide = description, guide
        self.capture, self.setup, self.size = capture, setup, size
        self.rough = RayCaster(rough)
        self.accurate = None if accurate is None else RayCaster(accurate)
        self._names: dict[int, str] = {}

    def frame(self, index: int) -> Frame:
        frame = fit(self.capture[index], self.size)
        self._names[index] = frame.name
        return frame

    def name(self, index: int) -> str:
        """Of frame `index`, which is only read if it was not yet."""
        return self._names.get(index) or self.frame(index).name

    def case(self, index: int) -> Case | None:
        """Frame `index` as a case; None if no ray meets the rough mesh or none meets the accurate one.

        Raises:
            InputError: the frame cannot be read.
        """
        frame = self.frame(index)
        seen = self.rough.gbuffer(frame.camera)
        truth = None if self.accurate is None else self.accurate.gbuffer(frame.camera)
        if not bool(seen.hit.any()) or (truth is not None and not bool(truth.hit.any())):
            return None
        display = jnp.asarray(frame.image)
        guide = self.guide.features(display)
        lights = tuple(self.setup.lights)
        shading, known = shade_each(seen, lights), seen.hit[..., None]
        colors = colored(jnp.eye(len(lights))[None], lights)[0] / self.setup.reference_lux
        if truth is None:
            target = cascade_known(shading, known, guide, Schedule.preset(CONVERGED_SCHEDULE))
            valid = jnp.ones_like(seen.hit)
        else:
            target, valid = shade_each(truth, lights), truth.hit
        return Case(shading, known, guide, to_linear(display), colors, mix(target, colors), valid)

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
        shapes = {case.known.shape[:2] for case in cases}
        if len(shapes) > 1:
            raise InputError(f"{self.capture.name}: frames of different sizes, {sorted(shapes)}; give a --size")
        if not cases and indices:
            raise InputError(
                f"{self.capture.name}: no ray of any of {len(indices)} {what} frames met the mesh; are the mesh "
                "and the poses in the same coordinates (metres, camera-to-world)?"
            )
        return cases, blind


def check_names(mesh: str | None, target: str | None, lights: str) -> None:
    """Raise `InputError` unless these can be opened: whatever can be known before the capture is read."""
    if not is_light_file(lights):
        check_setup_name(lights)
    check_mesh_name(mesh)
    if target != CONVERGED:
        check_mesh_name(target)


def open_bench(
    capture: Capture | Path | str | None = None,
    mesh: str | None = None,
    target: str | None = None,
    lights: str = "two-colors",
    *,
    size: tuple[int, int] | None = (512, 512),
    guide: FrameGuide = RGB,
    voxel: float = 0.03,
    seed: int = 0,
    repair: bool = False,
    progress: bool = True,
) -> Workbench:
    """Open everything that a schedule is judged on.

    Args:
        capture: frames with poses, or the folder that holds them; None for the built-in room.
        mesh: what is relit with: a file, `"captured"`, `"scan"`, `"fused"` or `"true"`, see `surface_of`. By
            default the mesh that came with the capture, or else a simulated scan.
        target: what the filter should have been shaded from: likewise, or `"converged"`, the diffusion of `mesh`
            run for 1000 steps. By default the built-in room's true mesh, a capture's fusion at 2 cm where it has
            depth, else `"converged"`.
        lights: a named set-up or a lights file.
        size: (height, width) to work at; None as captured.
        guide: what makes the guide of a frame.
        voxel: of a fused `mesh`, in metres.
        seed: of the simulated scan.
        repair: drop unusable triangles of a mesh file instead of refusing it.
        progress: show bars on stderr.

    Raises:
        InputError: any of these cannot be used.
    """
    check_names(mesh, target, lights)
    if capture is None:
        capture = load_room(progress=progress)
    elif not isinstance(capture, Capture):
        capture = open_capture(Path(capture))
    if target is None:
        with_depth = "true" if isinstance(capture, RoomCapture) else "fused"
        target = CONVERGED if capture[0].depth is None else with_depth
    source, rough = surface_of(
        capture, mesh or rough_mesh(capture), voxel=voxel, seed=seed, repair=repair, progress=progress
    )
    if target == CONVERGED:
        description, accurate = "1000 steps on the same mesh", None
    else:
        description, accurate = surface_of(
            capture, target, voxel=TARGET_VOXEL, seed=seed, repair=repair, progress=progress
        )
    if accurate is not None and np.array_equal(rough.vertices, accurate.vertices):
        raise InputError(f"target: {description} is the rough mesh itself, which needs no repair; choose another")
    if is_light_file(lights):
        setup = read_lights(Path(lights), capture.up)
    else:
        setup = named_setup(lights, survey_capture(RayCaster(rough if accurate is None else accurate), capture))
    return Workbench(capture, rough, accurate, setup, size, f"{source} against {description}", guide)
