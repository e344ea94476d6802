"""Options: values of the choices of a part of a configuration, and the types that a file of them may have."""

import dataclasses
import functools
import math
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

import msgspec
import numpy as np

from hyjax.choices.choice import Choice
from hyjax.choices.table import CHOICES, NO_STEPS, options_of
from hyjax.core.schedule import Schedule
from hyjax.util.errors import InputError, did_you_mean


class Options:
    """Values of the choices of a part of a configuration, as attributes; see `hyjax.choices.table`.

    Example:
        >>> LightOptions(bounces=False).replace(sampling=1)
        LightOptions(sampling=1, bounces=False)
    """

    PART: ClassVar[str]

    def __init__(self, **values: Any) -> None:
        known = options_of(self.PART)
        if unknown := sorted(values.keys() - known.keys()):
            guess = did_you_mean(unknown[0], known)
            raise InputError(f"{self.PART}: no choice {unknown[0]!r}{guess}; there are {', '.join(known)}")
        self.__dict__["_given"] = values

    def __getattr__(self, name: str) -> Any:
        known = options_of(self.PART)
        if name.startswith("_") or name not in known:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return self._given.get(name, known[name].default)

    def __setattr__(self, name: str, value: Any) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot assign to {name!r}; use replace")

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.values() == other.values()

    def __hash__(self) -> int:
        return hash(tuple(self.values().items()))

    def __repr__(self) -> str:
        given = [f"{name}={value!r}" for name, value in self.values().items() if name in self._given]
        return f"{type(self).__name__}({', '.join(given)})"

    def values(self) -> dict[str, Any]:
        """Value of each choice."""
        return {name: getattr(self, name) for name in options_of(self.PART)}

    def replace(self, **values: Any) -> Self:
        """The same with other values."""
        return type(self)(**(self._given | values))


class LightOptions(Options):
    """Options of the light on the surface: `sampling`, `photo_light`, `bounces` and others."""

    PART = "light"


class ShadowOptions(Options):
    """Options of shadows: `map_scale` and others; their cascade is `Configuration.shadow_schedule`."""

    PART = "shadows"


class GuideOptions(Options):
    """Options of the guide of the diffusion: `name`, `size`, `every`."""

    PART = "guide"


OPTIONS: dict[str, type[Options]] = {kind.PART: kind for kind in (LightOptions, ShadowOptions, GuideOptions)}


def annotated(choice: Choice) -> Any:
    """Type of a choice's values with its bounds, as msgspec takes it."""
    kind = choice.type
    if choice.bounds is not None:
        low, high = (choice.type(bound) for bound in choice.bounds)
        kind = Annotated[kind, msgspec.Meta(ge=low, le=high)]
    return kind | None if choice.default is None else kind


def wanted(choice: Choice) -> str:
    """Words for the values that a choice may have."""
    if get_origin(choice.type) is Literal:
        return f"one of {', '.join(map(str, get_args(choice.type)))}"
    kind = {bool: "true or false", int: "a whole number", float: "a number"}.get(choice.type, "another value")
    low, high = choice.bounds or (0, math.inf)
    bounds = (
        "" if choice.bounds is None else f" of {low:g} or more" if high >= 2**31 else f" from {low:g} to {high:g}"
    )
    return f"{kind}{bounds}{' or none' * (choice.default is None)}"


def kinds() -> dict[str, Any]:
    """Types of the choices outside the schedules, by field of a configuration."""
    found: dict[str, Any] = {c.key: annotated(c) for c in CHOICES.values() if not c.part}
    return found | {part: _struct(part, tuple(options_of(part).values())) for part in OPTIONS}


@functools.lru_cache(maxsize=16)
def _struct(name: str, choices: tuple[Choice, ...]) -> type[msgspec.Struct]:
    fields = [(choice.key, annotated(choice), choice.default) for choice in choices]
    return msgspec.defstruct(name, fields, frozen=True, kw_only=True, forbid_unknown_fields=True)


def value_of_schedule(schedule: Schedule, key: str) -> Any:
    """Value of a cascade's choice: its steps as text, a number of each level, or one of the whole."""
    levels = schedule.levels
    if key == "steps":
        return (
            " ".join(f"{level.factor}:{level.steps}" for level in levels)
            if any(x.steps for x in levels)
            else NO_STEPS
        )
    if key == "data_term":
        return any(level.fidelity is not None for level in levels)
    if key == "lam":
        return tuple(float(np.mean(level.step_sizes)) for level in levels if level.steps)
    if key in ("kappa", "fidelity"):
        numbers = (getattr(level, key) for level in levels)
        return tuple(None if number is None else float(np.asarray(number)) for number in numbers)
    return getattr(schedule, key)
