"""Scenes with known pictures, by which configurations are judged."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from hyjax.configuration import Configuration
from hyjax.data.capture import Capture
from hyjax.data.truth_room import TruthCapture, load_truth_room
from hyjax.light.color import to_display
from hyjax.light.relit import filter_and_light, relit_picture
from hyjax.scene.alignment import aligned
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.scene.surfaces import rough_mesh
from hyjax.tuning.rooms import ROOM_PREFIX, check_room
from hyjax.tuning.settings import CONVERGED_TARGET, ROOM_PHOTOS
from hyjax.util.errors import InputError
from hyjax.util.programs import run_kept
from hyjax.util.sizes import parse_size

ROOM_SIZE = "320x240"
KEPT_MAPS = 10
"""Sets of shadow maps that are kept of a scene."""


@dataclasses.dataclass(frozen=True)
class Target:
    """Picture that a frame should look like.

    Attributes:
        picture: display values.
        valid: where it means anything.
        fitted: whether exposure and white balance may be brought to it first.
    """

    picture: Float[np.ndarray, "h w 3"]
    valid: Bool[np.ndarray, "h w"]
    fitted: bool


class TuningScene:
    """A scene whose relit pictures can be judged.

    With a room of known truth the target is the true picture under the new lights. Else it is what an accurate
    surface makes of the frame, the photo's light left in on both sides: how well that is told, no capture says.

    Attributes:
        setup: function from a name, or a file, to the light set-up; kept.
        target: function from a set-up's name and a frame's position to the `Target`; kept.

    Args:
        accurate: the same capture on an accurate surface; None for a room of known truth.
    """

    def __init__(self, name: str, scene: Scene, accurate: Scene | None = None) -> None:
        self.name, self.scene, self.accurate = name, scene, accurate
        scene.kept_maps.most = KEPT_MAPS
        self.setup = functools.cache(functools.partial(scene.lights, at_photo_sources=True))
        self.target = functools.cache(self._target)

    def __len__(self) -> int:
        return len(self.scene)

    @property
    def has_truth(self) -> bool:
        """Whether the true pictures are known."""
        return self.accurate is None

    def relighter(self, lights: str, configuration: Configuration) -> Relighter:
        """Relighter of the frames under a configuration, to be timed."""
        return Relighter(self.scene, self.setup(lights), configuration)

    def judged(self, configuration: Configuration) -> Configuration:
        """Configuration as its pictures are compared: without choices that this scene's targets cannot judge."""
        return configuration if self.has_truth else configuration.with_choices({"photo_light": "kept"})

    def _target(self, lights: str, index: int) -> Target:
        capture, setup = self.scene.capture, self.setup(lights)
        if self.accurate is None:
            assert isinstance(capture, TruthCapture)
            picture = capture.truth(setup, [index])[0]
            return Target(picture, np.ones(picture.shape[:2], bool), True)
        view = self.accurate.view(index)
        plain = Configuration().with_choices({"sampling": 1, "photo_light": "kept"})
        shaded = Relighter(self.accurate, setup, plain, occluders="surface", whole=True).shade(view)
        raw = run_kept(filter_and_light, shaded, shaded.illuminance, shaded.visibility)  # nothing is refined
        image = run_kept(relit_picture, view, *raw, None, np.float32(1.0))
        return Target(np.asarray(to_display(image)), np.asarray(view.gbuffer.hit), False)


def open_room(name: str, size: str | None = None, seed: int = 0) -> TuningScene:
    """Room of known truth; photographed on first use, which takes a minute, and kept in the cache folder."""
    height, width = parse_size(size or ROOM_SIZE) or (0, 0)
    capture = load_truth_room(check_room(name), ROOM_PHOTOS, width, height)
    return TuningScene(name, Scene.open(SceneSettings(seed=seed), capture=capture))


def open_tuning_scene(source: str, size: str | None = None, seed: int = 0) -> TuningScene:
    """Scene by name: `room:NAME`, the folder of a capture, or `built-in`."""
    if source.startswith(ROOM_PREFIX):
        return open_room(source.removeprefix(ROOM_PREFIX), size, seed)
    capture = None if source == "built-in" else Path(source)
    scene, accurate = open_scenes(SceneSettings(capture, size=size, seed=seed))
    if accurate is None:
        raise InputError(f"{source}: has no depth, so no accurate surface; a frame cannot be judged on it")
    return TuningScene(source, scene, accurate)


def spread_cases(frames: Sequence[Sequence[int]], lights: Sequence[str], seed: int) -> list[tuple[int, str, int]]:
    """Cases in the order of mini-batches: (scene, set-up, frame), such that each few have many scenes and set-ups.

    >>> spread_cases([[0, 5], [3]], ["noon-window"], 0)
    [(0, 'noon-window', 0), (1, 'noon-window', 3), (0, 'noon-window', 5)]
    """
    rng = np.random.default_rng(seed)
    cases: list[tuple[int, str, int]] = []
    for number in range(max(len(own) for own in frames)):
        for turn in range(len(lights)):
            for place, own in enumerate(frames):
                if number < len(own):
                    light = lights[(turn + place) % len(lights)]
                    cases.append((place, light, own[(number + turn) % len(own)]))
    rounds = [cases[k : k + len(frames)] for k in range(0, len(cases), len(frames))]
    return [case for k in rng.permutation(len(rounds)) for case in rounds[k]]


TARGET_VOXEL = 0.02


def open_scenes(
    settings: SceneSettings, target: str | None = None, *, capture: Capture | None = None, progress: bool = False
) -> tuple[Scene, Scene | None]:
    """A capture on its rough surface, and on an accurate one.

    Returns:
        The second is None where the target is the converged diffusion on the rough surface.
    """
    if capture is None:
        capture = settings.open_capture(progress=progress)
    if target is None:
        with_depth = "fused" if capture.reference() is None else "true"
        target = CONVERGED_TARGET if not capture.depth_count else with_depth
    if target == "fused":  # whose poses both scenes must have
        capture = aligned(capture, settings.fusion, progress)
    rough = dataclasses.replace(settings, mesh=settings.mesh or rough_mesh(capture))
    scene, accurate = Scene.open(rough, capture=capture, progress=progress), None
    if target != CONVERGED_TARGET:
        fusion = dataclasses.replace(settings.fusion, voxel=TARGET_VOXEL)
        better = dataclasses.replace(settings, mesh=target, fusion=fusion)
        accurate = Scene.open(better, capture=capture, progress=progress)
        if np.array_equal(scene.mesh.vertices, accurate.mesh.vertices):
            raise InputError(
                f"target: {accurate.source} is the rough mesh itself, which needs no repair; choose another"
            )
    return scene, accurate
