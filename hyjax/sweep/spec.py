"""Specifications of sweeps: YAML or JSON, checked key by key.

    scenes: [room:builtin-0, captures/kitchen]       # rooms of known truth, or captures
    lights: [evening-lamps, my_lamps.yaml]           # named set-ups, or files
    configurations: {space: default, count: 50, seed: 0}
    frames: 4                                        # so many, spread over the photos; or a list
    size: 320x240
    seeds: [0]
    time: false                                      # also time every configuration, alone on the device

`configurations` may also be a list of names and JSON files. Files are looked for from the folder of the spec.
"""

import json
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from hyjax.configuration import Configuration
from hyjax.data.frames import spread
from hyjax.data.hand_written import converted
from hyjax.data.light_file import is_light_file
from hyjax.scene.settings import check_lights_name
from hyjax.tuning.rooms import ROOM_PREFIX, check_room
from hyjax.tuning.settings import ROOM_PHOTOS
from hyjax.tuning.space import Space
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.reading import exists, read_yaml
from hyjax.util.sizes import parse_size

SPACES = ("default",)
Names = Annotated[list[str], msgspec.Meta(min_length=1)]
Positive = Annotated[int, msgspec.Meta(ge=1)]
Numbers = Annotated[list[Annotated[int, msgspec.Meta(ge=0)]], msgspec.Meta(min_length=1)]
FORMS = {
    "scenes": "a list of at least one text",
    "lights": "a list of at least one text",
    "configurations": "a list of names and files, or a mapping with space, count and seed",
    "frames": "a number >= 1, or a list of numbers >= 0",
    "size": "a text such as 320x240",
    "seeds": "a list of whole numbers >= 0",
    "time": "true or false",
}
DRAW_FORMS = {"space": "a text", "count": "a whole number >= 1", "seed": "a whole number >= 0"}


class Draws(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Configurations drawn at random.

    Attributes:
        space: of the draws.
        count: of the configurations.
        seed: of the draws.
    """

    space: str
    count: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0


class Spec(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Specification of a sweep: every scene under every light with every configuration and seed.

    Attributes:
        scenes: `room:NAME`, or paths of captures.
        lights: named set-ups, or paths of files.
        configurations: names and paths of files, or draws.
        frames: their number, or positions.
        size: of the pictures, width x height.
        seeds: of simulated scans.
        time: whether to time as well.
    """

    scenes: Names
    lights: Names
    configurations: Names | Draws
    frames: Positive | Numbers = 4
    size: str = "320x240"
    seeds: Numbers = msgspec.field(default_factory=lambda: [0])
    time: bool = False


def read_spec(path: Path) -> Spec:
    """Read a spec; files in it get absolute paths."""
    where = str(path)
    content = read_yaml(path)
    draws = content.get("configurations") if isinstance(content, dict) else None
    if isinstance(draws, dict):
        inside = f"{where}: configurations"
        converted(inside, draws, Draws, DRAW_FORMS)
        if draws["space"] not in SPACES:
            hint = did_you_mean(draws["space"], SPACES)
            raise InputError(f"{inside}: no space {draws['space']!r}{hint}; there is {', '.join(SPACES)}")
    spec: Spec = converted(where, content, Spec, FORMS)
    for name in ("scenes", "lights", "configurations", "seeds", "frames"):
        values = getattr(spec, name)
        if isinstance(values, list) and len(set(values)) < len(values):
            raise InputError(f"{where}: {name!r} must not repeat a name")
    try:
        parse_size(spec.size)
        return _absolute(spec, path.resolve().parent)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _absolute(spec: Spec, folder: Path) -> Spec:
    """Spec with absolute paths of its files, all of which exist."""
    scenes = [_scene(scene, folder) for scene in spec.scenes]
    lights = [str(folder / light) if is_light_file(light) else light for light in spec.lights]
    for light in lights:
        check_lights_name(light)
    configurations = spec.configurations
    if isinstance(configurations, list):
        configurations = [str(folder / name) if name.endswith(".json") else name for name in configurations]
    return msgspec.structs.replace(spec, scenes=scenes, lights=lights, configurations=configurations)


def _scene(scene: str, folder: Path) -> str:
    if scene.startswith(ROOM_PREFIX):
        check_room(scene.removeprefix(ROOM_PREFIX))
        return scene
    if not exists(folder / scene):
        raise InputError(f"scenes: no capture {folder / scene}; a room of known truth is called {ROOM_PREFIX}NAME")
    return str(folder / scene)


def frames_of(spec: Spec, scene: str) -> list[int]:
    """Frames of a scene, by position."""
    if scene.startswith(ROOM_PREFIX):
        count = ROOM_PHOTOS
    else:
        from hyjax.data.registry import open_capture

        count = len(open_capture(Path(scene)))
    if isinstance(spec.frames, int):
        return spread(range(count), spec.frames)
    if max(spec.frames) >= count:
        raise InputError(f"frames: {max(spec.frames)} is past the end of {scene}, which has {count}")
    return list(spec.frames)


def configurations_of(spec: Spec) -> dict[str, dict[str, Any]]:
    """Configurations by name, in JSON's types."""
    if isinstance(spec.configurations, Draws):
        draws = spec.configurations
        drawn = random_configurations(draws.count, draws.seed)
        return {f"{draws.space}-{draws.seed}-{number}": _plain(one) for number, one in enumerate(drawn)}
    found: dict[str, dict[str, Any]] = {}
    for text in spec.configurations:
        name = Path(text).stem
        if name in found:
            raise InputError(f"configurations: two are called {name!r}; rename one of the files")
        found[name] = _plain(Configuration.open(text))
    return found


def _plain(configuration: Configuration) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(configuration.to_json())
    # The same under another name, or measured elsewhere, is the same.
    return {name: value for name, value in content.items() if name not in ("name", "measured")}


def random_configurations(count: int, seed: int) -> list[Configuration]:
    """Random configurations, the default first; the same for the same seed."""
    space, rng = Space.of(truth=True), np.random.default_rng(seed)
    drawn = [space.default, *(space.random(rng) for _ in range(count - 1))]
    return [space.configuration(choices, f"random-{seed}-{n}") for n, choices in enumerate(drawn)][:count]
