"""Controls of the choices and the cascades, changes by them, and the script that makes the same picture."""

import dataclasses
import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np

from hyjax.choices.choice import Choice
from hyjax.choices.table import CASCADES, CHOICES, NO_STEPS
from hyjax.configuration import PRESETS, Configuration
from hyjax.core.schedule import GUIDED_FIDELITY, Level, Schedule
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.light.setup import LightSetup
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError, shown

GROUPS = {
    "": "Frame",
    "guide": "Guide",
    "schedule": "Cascade of the light",
    "shadow_schedule": "Shadow pass",
    "shadows": "Shadows",
    "light": "Light of the photo, bounces",
}
"""Headings of the parts of a configuration."""
LADDER = "steps", "kappa", "lam", "fidelity"
"""What each level of a cascade has, in the order of its controls."""
WIDEST_SLIDER = 64
"""Whole numbers with more values than this are typed."""


def control(choice: Choice) -> dict[str, Any]:
    """Control of a choice, as the page makes it."""
    found: dict[str, Any] = {"name": choice.name, "label": choice.label or choice.name.replace("_", " ")}
    found |= {"help": choice.help, "group": GROUPS.get(choice.part, choice.part), "none": choice.default is None}
    tried = choice.tried
    if choice.type is bool:
        return found | {"kind": "switch"}
    if values := get_args(choice.type):
        return found | {"kind": "list", "values": values}
    if choice.key == "steps":
        return found | {"kind": "text", "values": ()}
    if choice.type is str:
        return found | {"kind": "text", "values": [] if tried is None else tried.values}
    low, high = choice.bounds or (tried.values if tried else (0.0, 1.0))
    if choice.type is int and high - low > WIDEST_SLIDER:
        return found | {"kind": "number", "low": low}
    log = tried is not None and tried.scale == "log" and low > 0
    step = 1 if choice.type is int else 0
    return found | {"kind": "slider", "low": low, "high": high, "log": log, "step": step}


def controls() -> list[dict[str, Any]]:
    """Controls of all choices, by group; what each level of a cascade has is in its ladder."""
    ladder = [f"{part}.{key}" for part in CASCADES for key in LADDER[1:]]
    chosen = [choice for choice in CHOICES.values() if choice.field not in ladder]
    return [control(choice) for part in GROUPS for choice in chosen if choice.part == part] + [
        control(choice) for choice in chosen if choice.part not in GROUPS
    ]


def values(configuration: Configuration) -> dict[str, Any]:
    """Value of each control; None for what has none."""
    found = {name: configuration.value(name) for name in CHOICES}
    return {name: None if isinstance(value, tuple) else value for name, value in found.items()}


def ladders(
    configuration: Configuration, ends: Mapping[str, Sequence[int]]
) -> dict[str, list[dict[str, float | int | None]]]:
    """Levels of both cascades, with the numbers of their sliders."""

    def row(level: Level, most: int) -> dict[str, float | int | None]:
        alpha = None if level.fidelity is None else float(np.asarray(level.fidelity))
        numbers = {"kappa": float(np.asarray(level.kappa)), "lam": _lam(level), "fidelity": alpha}
        return {"factor": level.factor, "steps": level.steps, **numbers, "most_steps": most}

    return {part: [*map(row, getattr(configuration, part).levels, ends[part])] for part in CASCADES}


def _lam(level: Level) -> float:
    """Middle one of a level's step sizes."""
    return float(np.median(np.asarray(level.step_sizes, np.float64))) if level.steps else DEFAULT_LAM


def with_choice(configuration: Configuration, name: str, value: Any) -> Configuration:
    """Configuration with another value of any choice; of one that each level of a cascade has, in all of them."""
    choice = CHOICES.get(name)
    if choice is None or choice.part not in CASCADES:
        return configuration.with_choices({name: value}).check()
    schedule = getattr(configuration, choice.part)
    if choice.key == "steps":
        schedule = with_steps(schedule, value)
    elif choice.key == "data_term":
        alpha = np.float32(GUIDED_FIDELITY) if value else None
        schedule = dataclasses.replace(
            schedule, levels=tuple(dataclasses.replace(level, fidelity=alpha) for level in schedule.levels)
        )
    else:
        schedule = dataclasses.replace(schedule, **{choice.key: value})
    return _with_schedule(configuration, choice.part, schedule)


def with_level(configuration: Configuration, part: str, index: int, key: str, value: Any) -> Configuration:
    """Configuration with another number of one level of a cascade.

    Args:
        value: the number; of a fidelity also None.
    """
    levels = list(getattr(configuration, part).levels) if part in CASCADES else []
    if key not in LADDER or isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(levels):
        raise InputError(f"cascade: no {shown(key)} of level {shown(index)} of {shown(part)}")
    number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
    if not number and not (value is None and key == "fidelity"):
        raise InputError(f"{part}, factor {levels[index].factor}, {key}: must be a number, got {shown(value)}")
    level = levels[index]
    if key == "steps":
        if not 0 <= value <= 1000 or value != int(value):
            raise InputError(f"{part}, factor {level.factor}, steps: must be 0 to 1000, got {shown(value)}")
        changed: Any = {"step_sizes": np.full(int(value), _lam(level), np.float32)}
    elif key == "lam":
        changed = {"step_sizes": np.full(level.steps, value, np.float32)}
    else:
        changed = {key: None if value is None else np.float32(value)}
    levels[index] = dataclasses.replace(level, **changed)
    schedule = dataclasses.replace(getattr(configuration, part), levels=tuple(levels))
    return _with_schedule(configuration, part, schedule)


def with_steps(schedule: Schedule, text: Any) -> Schedule:
    """Schedule of other levels, as factor:steps; each takes κ, λ and α on from the old one nearest in size."""
    if not isinstance(text, str):
        raise InputError(f"cascade: levels must be text such as '16:3 8:4', got {shown(text)}")
    try:
        pairs = (
            [tuple(map(int, word.split(":"))) for word in text.split()] if text.strip() != NO_STEPS else [(1, 0)]
        )
        levels = []
        for factor, steps in pairs:
            near = min(schedule.levels, key=lambda level: abs(np.log(level.factor / factor)))
            sizes = np.full(steps, _lam(near), np.float32)
            levels.append(dataclasses.replace(near, factor=factor, step_sizes=sizes))
    except (ValueError, ZeroDivisionError, MemoryError):
        raise InputError(f"cascade: levels must be as '16:3 8:4' (factor:steps), got {shown(text)}") from None
    return dataclasses.replace(schedule, levels=tuple(levels)).check()


def _with_schedule(configuration: Configuration, part: str, schedule: Schedule) -> Configuration:
    if _alike(schedule, getattr(configuration, part)):
        return configuration
    name = "custom"
    change: Any = {part: dataclasses.replace(schedule, name=name)}
    changed = dataclasses.replace(configuration, **change)
    return dataclasses.replace(changed, name=name, measured=None).check()


def _alike(a: Schedule, b: Schedule) -> bool:
    """Whether two schedules differ in nothing but their names, which are of tables only."""
    return dataclasses.replace(a, name=b.name) == b


def _is_preset(configuration: Configuration, preset: Configuration) -> bool:
    """Whether a configuration makes a preset's pictures, whatever it and its cascades are called."""
    parts = {part: getattr(preset, part) for part in CASCADES}
    same = all(_alike(getattr(configuration, part), schedule) for part, schedule in parts.items())
    names: Any = parts | {"name": preset.name, "measured": preset.measured}
    return same and dataclasses.replace(configuration, **names) == preset


def script(
    settings: SceneSettings | None, frame: int, lights: LightSetup | str, configuration: Configuration
) -> str:
    """Program that makes the picture.

    Args:
        settings: of the scene; None where the program must be given it, as `scene`.
    """
    lines = ["from pathlib import Path", "", "import numpy as np", "", "import hyjax", ""]
    if settings is None:
        lines.append("# scene: the one that was explored")
    else:
        lines.append(f"scene = hyjax.Scene.open({_code(settings)})")
    lines.append(f"lights = {_code(lights)}")
    lines.append(f"configuration = {configuration_code(configuration)}")
    lines.append(f"relit = scene.relit({frame}, lights, configuration)")
    lines.append('hyjax.write_png(Path("relit.png"), np.asarray(hyjax.to_display(relit.image)))')
    return "\n".join(lines) + "\n"


def configuration_code(configuration: Configuration) -> str:
    """Expression of a configuration: a preset's name, or what differs from the default."""
    for name, preset in _presets().items():
        if _is_preset(configuration, preset):
            return f'hyjax.Configuration.preset("{name}")'
    default, parts = Configuration(), []
    for part in CASCADES:
        schedule = getattr(configuration, part)
        if not _alike(schedule, getattr(default, part)):
            parts.append(f"    {part}=hyjax.Schedule.from_json({_text(_compact(schedule))}),\n")
    code = f"hyjax.Configuration(\n{''.join(parts)})" if parts else "hyjax.Configuration()"
    own = {
        name: configuration.value(name)
        for name, choice in CHOICES.items()
        if choice.part not in CASCADES and configuration.value(name) != default.value(name)
    }
    return f"{code}.with_choices({own!r})" if own else code


@functools.cache
def _presets() -> dict[str, Configuration]:
    """Presets by name, read once: a program is written with every picture."""
    return {name: Configuration.preset(name) for name in ("default", "paper", *PRESETS)}


def _compact(schedule: Schedule) -> str:
    """JSON of a schedule with one level a line."""
    content = json.loads(schedule.to_json())
    levels = ",\n".join(f"  {json.dumps(level)}" for level in content.pop("levels"))
    head = json.dumps(content)[:-1]
    return f'\n{head}, "levels": [\n{levels}\n]}}\n'


def _text(text: str) -> str:
    return f'"""{text}"""' if '"""' not in text and "\\" not in text else repr(text)


def _code(value: Any) -> str:
    """Expression of settings, lights and the values in them, exact."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        given = []
        for field in dataclasses.fields(value):
            own = getattr(value, field.name)
            usual = field.default
            if field.default_factory is not dataclasses.MISSING:
                usual = field.default_factory()
            if usual is dataclasses.MISSING or not _equal(own, usual):
                given.append(f"{field.name}={_code(own)}")
        name = type(value).__name__
        import hyjax

        prefix = "hyjax." if hasattr(hyjax, name) else f"__import__({type(value).__module__!r}, fromlist=['x'])."
        return f"{prefix}{name}({', '.join(given)})"
    if isinstance(value, tuple):
        return f"({''.join(_code(each) + ', ' for each in value)})"
    if isinstance(value, Mapping):
        return repr({key: _plain(each) for key, each in value.items()})
    if hasattr(value, "shape") and np.ndim(value):
        return f"np.array({np.asarray(value).tolist()})"
    if hasattr(value, "__fspath__"):
        return f"Path({str(value)!r})"
    return repr(_plain(value))


def _plain(value: Any) -> Any:
    return np.asarray(value).tolist() if hasattr(value, "shape") else value


def _equal(a: Any, b: Any) -> bool:
    if hasattr(a, "shape") or hasattr(b, "shape"):
        return b is not None and a is not None and bool(np.array_equal(a, b))
    return bool(a == b)
