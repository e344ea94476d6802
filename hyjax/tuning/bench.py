"""Benches: the scenes, frames and targets that a run tunes on, of whole frames or of the diffusion alone."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
from tqdm import tqdm

from hyjax.core.schedule import Schedule
from hyjax.data.capture import Capture
from hyjax.data.frames import spread
from hyjax.guide.choose import RGB, FrameGuide
from hyjax.light.setup import LightSetup
from hyjax.scene.place import view_of
from hyjax.scene.scene import Scene
from hyjax.tuning.cases import Case, raw_filter, refined_filter
from hyjax.tuning.clock import slowest_setup
from hyjax.tuning.evaluation import FrameCase
from hyjax.tuning.request import split_frames
from hyjax.tuning.scene import TuningScene, open_room, open_scenes, spread_cases
from hyjax.tuning.settings import DIFFUSION_LIGHTS, TuneSettings
from hyjax.util.errors import InputError

CONVERGED_SCHEDULE = "naive-1000"


class Workbench:
    """A scene under lights, with the accurate surface that its pictures should look like.

    Args:
        accurate: the same capture on the mesh that the target is shaded from; None to aim at the converged
            diffusion on the rough one.
    """

    def __init__(self, scene: Scene, accurate: Scene | None, lights: LightSetup, guide: FrameGuide = RGB) -> None:
        self.scene, self.accurate, self.lights, self.guide = scene, accurate, lights, guide
        self._names: dict[int, str] = {}

    @property
    def description(self) -> str:
        """The two meshes in a few words, for the record."""
        target = "1000 steps on the same mesh" if self.accurate is None else self.accurate.source
        return f"{self.scene.source} against {target}"

    def name(self, index: int) -> str:
        """Name of frame `index`, which is read once at most for it."""
        if index not in self._names:
            self._names[index] = self.scene.capture.picture(index).name
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
        """The frames that make cases, and the names of those that see no surface."""
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


def open_bench(settings: TuneSettings, *, capture: Capture | None = None, guide: FrameGuide = RGB) -> Workbench:
    """Workbench of the settings' capture, or of the built-in room, or of frames that were opened before."""
    scene, accurate = open_scenes(settings.scene, settings.target, capture=capture, progress=not settings.quiet)
    return Workbench(scene, accurate, (accurate or scene).lights(settings.lights or DIFFUSION_LIGHTS), guide)


@dataclasses.dataclass(frozen=True)
class FrameBench:
    """Scenes, cases and loss of a tuning run.

    Attributes:
        scenes: of the cases and the held-out cases.
        cases: in the order of batches.
        held_out: on which nothing is chosen.
        lights: the set-up that is timed.
    """

    scenes: list[TuningScene]
    cases: list[FrameCase]
    held_out: list[FrameCase]
    lights: str


def open_frame_bench(settings: TuneSettings, capture: Capture | None = None) -> FrameBench:
    """Scenes and cases of the settings."""
    options, lights = settings.frame, settings.set_ups()
    if options.rooms:
        names = (*options.rooms, *options.holdout_rooms)
        bar = tqdm(names, "rooms", unit="room", disable=settings.quiet)
        scenes = [open_room(name, options.room_size) for name in bar]
        frames = [spread(range(len(scene)), options.room_frames) for scene in scenes]
        count = len(options.rooms)
        cases = spread_cases(frames[:count], lights, settings.scene.seed)
        held = spread_cases(frames[count:], lights, settings.scene.seed) if options.holdout_rooms else []
        shifted = [(place + count, name, index) for place, name, index in held]
        return FrameBench(scenes, cases, shifted, slowest_setup(scenes[0], lights))
    capture = capture or settings.scene.open_capture(progress=not settings.quiet)
    chosen, holdout = split_frames(len(capture), settings.frames, settings.holdout)
    rough, accurate = open_scenes(settings.scene, settings.target, capture=capture, progress=not settings.quiet)
    if accurate is None:
        raise InputError(
            f"{rough.capture.name}: has no accurate surface to judge frames by; tune with --rooms, or with "
            "--stage cascade"
        )
    scene = TuningScene(rough.capture.name, rough, accurate)
    cases, held_out = (
        spread_cases([indices], lights, settings.scene.seed) if indices else [] for indices in (chosen, holdout)
    )
    return FrameBench([scene], cases, held_out, slowest_setup(scene, lights))
