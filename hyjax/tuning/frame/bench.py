"""Bench of the whole frame: scenes and cases that a run tunes on."""

import dataclasses

from tqdm import tqdm

from hyjax.data.capture import Capture
from hyjax.data.frames import spread
from hyjax.tuning.bench import open_scenes
from hyjax.tuning.frame.clock import slowest_setup
from hyjax.tuning.frame.evaluation import Case
from hyjax.tuning.frame.scene import TuningScene, open_room, spread_cases
from hyjax.tuning.request import split_frames
from hyjax.tuning.settings import TuneSettings
from hyjax.util.errors import InputError


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
    cases: list[Case]
    held_out: list[Case]
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
