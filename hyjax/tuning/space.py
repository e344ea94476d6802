"""Search space of configurations: parameters of the choices, and which of them others depend on.

A cascade has a parameter for each of its levels, the number of its steps: `cascade_16` is that of the level of
factor 16, 0 where there is no such level. A number of a cascade may be one for all levels or one for each.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hyjax.choices.choice import Choice, Renderer, Tried
from hyjax.choices.table import CASCADES, CHOICES, NO_STEPS
from hyjax.configuration import Configuration
from hyjax.core.cascade import largest_sampling
from hyjax.core.schedule import Schedule
from hyjax.guide.choose import NO_GUIDE
from hyjax.tuning.budget import MOST_STEPS
from hyjax.tuning.cascade_numbers import with_numbers
from hyjax.util.errors import InputError

Choices = dict[str, Any]
"""Value of each parameter by name; those that are not active are left out."""
Levels = tuple[tuple[int, int], ...]
COUNTS = (0, 1, 2, 3, 4, 6, 8, 10, 12, 15, 20, 25, 30)
"""Numbers of steps that are drawn; any up to `MOST_STEPS` may be taken."""
BARE_LEVELS = ((4, 0),)
"""Levels of a cascade without steps."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One choice, or the steps of one level of a cascade.

    Attributes:
        name: in tables and journals.
        values: that it may have, in order where it has one; of a range, (lowest, highest).
        default: today's.
        continuous: whether all values between the two of `values` may be taken.
        ordered: whether neighbouring values are alike.
        active: whether it means anything beside other choices.
        log: whether a range is on a logarithmic scale.
        cascade: choice whose level's steps it is, if it is that.
        factor: of that level.
    """

    name: str
    values: tuple[Any, ...]
    default: Any
    continuous: bool = False
    ordered: bool = False
    active: Callable[[Mapping[str, Any]], bool] = lambda choices: True
    log: bool = True
    cascade: str = ""
    factor: int = 0

    @classmethod
    def of(cls, choice: Choice, tried: Tried, *, paper: bool = False) -> "list[Parameter]":
        """Parameters of a row of the table with the values tried; in the paper's form all mean something."""
        start = choice.default if tried.start is None else tried.start
        if tried.scale == "steps":
            steps = dict(levels_of(start))
            return [
                cls(f"{choice.name}_{f}", COUNTS, steps.get(f, 0), ordered=True, cascade=choice.name, factor=f)
                for f in tried.values
            ]
        ranged, ordered = tried.scale in ("linear", "log"), tried.scale == "ordered"
        active = (lambda choices: True) if paper else choice.active
        return [cls(choice.name, tried.values, start, ranged, ordered, active, tried.scale == "log")]

    def holds(self, value: Any) -> bool:
        """Whether it may have a value."""
        if self.factor:
            return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_STEPS
        if not self.continuous:
            return value in self.values
        low, high = self.values
        numbers = value if isinstance(value, tuple) and value else (value,)
        return all(isinstance(x, int | float) and low <= x <= high for x in numbers)

    def place(self, value: Any) -> float:
        """Value as a number in [0, 1], in the order of the values."""
        if self.factor:
            return math.log2(1 + value) / math.log2(1 + MOST_STEPS)
        if self.continuous:
            low, high, middle = (math.log(x) if self.log else x for x in (*self.values, self.middle(value)))
            return (middle - low) / (high - low)
        return self.values.index(value) / max(len(self.values) - 1, 1)

    def middle(self, value: Any) -> float:
        """A range's number, or the mean of those of several levels."""
        numbers = np.atleast_1d(np.asarray(value, float))
        mean = np.exp(np.mean(np.log(numbers))) if self.log else np.mean(numbers)
        return float(np.clip(mean, *self.values))

    def at(self, position: float) -> Any:
        """Value of a range at a number in [0, 1]."""
        low, high = (math.log(x) if self.log else x for x in self.values)
        value = low + position * (high - low)
        return float(np.clip(math.exp(value) if self.log else value, *self.values))

    def draw(self, rng: np.random.Generator) -> Any:
        """A random value; every other level has no steps."""
        if self.factor and rng.random() < 0.5:
            return 0
        return self.at(rng.random()) if self.continuous else self.values[int(rng.integers(len(self.values)))]

    def others(self, value: Any) -> list[Any]:
        """Other values to try in the place of one: all, or of steps none, half and twice as many, one more."""
        if self.factor:
            found = (0, value // 2, value + 1, min(2 * value, MOST_STEPS) if value else 4)
            return [n for n in dict.fromkeys(found) if n != value and n <= MOST_STEPS]
        return [other for other in self.values if other != value]


@dataclasses.dataclass(frozen=True)
class Space:
    """Search space.

    Attributes:
        parameters: each after those that it depends on.
        paper: whether it is of the paper's form.
        fixed: choices that are not searched, in the place of the default's.
    """

    parameters: tuple[Parameter, ...]
    paper: bool = False
    fixed: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls, *, truth: bool, paper: bool = False, renderer: Renderer | None = None, held: Choices | None = None
    ) -> "Space":
        """Space of linear light, or of the paper's form.

        Args:
            truth: whether true pictures judge.
            renderer: only of the choices that it follows.
            held: values of choices that are not searched.
        """
        if paper:
            parameters = [p for c in CHOICES.values() if c.paper for p in Parameter.of(c, c.paper, paper=True)]
            return cls(tuple(parameters), True)
        chosen = [choice for choice in CHOICES.values() if choice.tried and (truth or not choice.truth)]
        left = {} if renderer is None else {c.name: c.usual_value for c in chosen if not c.followed_by(renderer)}
        left |= held or {}
        kept = [choice for choice in chosen if choice.name not in left]
        return cls(tuple(p for c in kept if c.tried for p in Parameter.of(c, c.tried)), fixed=left)

    @classmethod
    def of_cascade(cls, factors: Sequence[int], ranges: Mapping[str, tuple[float, float]]) -> "Space":
        """Space of the cascade for the light alone, with levels of these factors and ranges of its numbers."""
        usual = dict(levels_of(CHOICES["cascade"].default))
        start = {f: n for f, n in usual.items() if f in factors} or {factors[0]: usual[min(usual)]}
        tried = {"cascade": Tried(tuple(factors), " ".join(f"{f}:{n}" for f, n in start.items()), "steps")}
        tried |= {name: Tried(values, scale="log") for name, values in ranges.items()}
        found = [p for name, values in tried.items() for p in Parameter.of(CHOICES[name], values)]
        return cls(tuple(found), fixed=Configuration().values())

    @functools.cached_property
    def named(self) -> dict[str, Parameter]:
        """Parameters by name."""
        return {parameter.name: parameter for parameter in self.parameters}

    @functools.cached_property
    def default(self) -> Choices:
        """Choices of the default configuration."""
        return self.complete({})

    def levels(self, choices: Mapping[str, Any], cascade: str) -> Levels:
        """Levels of a cascade that have steps, coarse to fine; `BARE_LEVELS` if none has."""
        parameters = [p for p in self.parameters if p.cascade == cascade]
        found = tuple(
            (p.factor, choices.get(p.name, p.default)) for p in parameters if choices.get(p.name, p.default)
        )
        return found or BARE_LEVELS

    def complete(self, choices: Mapping[str, Any]) -> Choices:
        """Choices completed by defaults, without inactive ones.

        Cascades may be given as text, such as `cascade="16:3 8:4"`. Of samplings that the cascades do not allow,
        the largest that they do.

        Raises:
            InputError: a name or value that is none of the space's.
        """
        given = {n: tuple(v) if isinstance(v, list) else v for n, v in self._expanded(choices).items()}
        if unknown := sorted(given.keys() - self.named.keys()):
            raise InputError(f"choices: no parameter {unknown[0]!r}; there are {', '.join(sorted(self.named))}")
        completed = {p.name: given.get(p.name, p.default) for p in self.parameters}
        for name, value in completed.items():
            if not self.named[name].holds(value):
                raise InputError(f"choices: {name} {value!r} is not among {self.named[name].values}")
        text = self.seen(completed)
        if "sampling" in self.named and "cascade" in self._cascades:
            held = text.get("data_term", True)
            allowed = _allowed(completed["sampling"], text["cascade"], text.get("shadow_pass", NO_STEPS), held)
            completed["sampling"] = allowed
        for name, value in completed.items():
            if isinstance(value, tuple):
                cascade = _cascade_of(name)
                apart = cascade and len(value) == len(self.levels(completed, cascade))
                if not apart or len(set(value)) == 1:
                    completed[name] = self.named[name].middle(value)
        return {p.name: completed[p.name] for p in self.parameters if p.active(text)}

    def seen(self, choices: Mapping[str, Any]) -> Choices:
        """Choices as rows of the table look at them, cascades as text among them."""
        return dict(self.fixed) | dict(choices) | {name: self._text(choices, name) for name in self._cascades}

    @functools.cached_property
    def _cascades(self) -> list[str]:
        return list(dict.fromkeys(p.cascade for p in self.parameters if p.cascade))

    def _expanded(self, choices: Mapping[str, Any]) -> Choices:
        """Choices with the steps of each level in the place of a cascade's text."""
        found = dict(choices)
        for name in self._cascades:
            if name in found:
                steps = dict(levels_of(found.pop(name)))
                found |= {p.name: steps.pop(p.factor, 0) for p in self.parameters if p.cascade == name}
                if any(steps.values()):
                    raise InputError(f"choices: {name} has no level of factor {max(steps)} in this search")
        return found

    def _text(self, choices: Mapping[str, Any], cascade: str) -> str:
        levels = self.levels(choices, cascade)
        return NO_STEPS if levels == BARE_LEVELS else " ".join(f"{factor}:{count}" for factor, count in levels)

    def random(self, rng: np.random.Generator) -> Choices:
        """Random choices."""
        return self.complete({parameter.name: parameter.draw(rng) for parameter in self.parameters})

    def changes(self, choices: Choices) -> list[Choices]:
        """Choices that differ in one discrete parameter, and in those that it makes inactive."""
        found: list[Choices] = []
        for parameter in self.parameters:
            if parameter.continuous or parameter.name not in choices:
                continue
            for value in parameter.others(choices[parameter.name]):
                changed = self.complete(choices | {parameter.name: value})
                if changed[parameter.name] == value:
                    found.append(changed)
        return found

    def mutated(self, choices: Choices, rng: np.random.Generator, rate: float) -> Choices:
        """Choices of which each is changed with a probability; numbers of ranges by a little."""
        changed = dict(choices)
        for parameter in self.parameters:
            if rng.random() >= rate:
                continue
            value = choices.get(parameter.name, parameter.default)
            if parameter.continuous:
                changed[parameter.name] = parameter.at(parameter.place(value) + 0.12 * rng.standard_normal())
            elif parameter.factor and rng.random() < 0.7:
                changed[parameter.name] = int(rng.choice(parameter.others(value)))
            else:
                changed[parameter.name] = parameter.draw(rng)
        return self.complete(changed)

    def choices_of(self, configuration: Configuration) -> Choices:
        """Choices of a configuration; the default's for values outside the space."""
        found: Choices = {}
        for name, value in self._expanded(_known(configuration.values(), self)).items():
            parameter = self.named.get(name)
            if parameter is not None and parameter.continuous and value is not None:
                value = value if isinstance(value, tuple) else (value,)
                value = tuple(float(np.clip(x, *parameter.values)) for x in value if x is not None)
                value = value[0] if len(value) == 1 else value
            if parameter is not None and parameter.holds(value):
                found[name] = value
        return self.complete(found)

    def configuration(self, choices: Mapping[str, Any], name: str = "tuned") -> Configuration:
        """Configuration of these choices."""
        expanded = self._expanded(choices)
        full = dict(self.fixed) | {p.name: p.default for p in self.parameters} | expanded
        schedule = Schedule.uniform(
            self.levels(full, "cascade"),
            fidelity=1.0 if full.get("data_term") else None,
            pooling=full["pooling"],
            norm=full.get("norm", "l2"),
            upsampling=full.get("upsampling", "bilinear"),
            name=name,
        )
        schedule = with_numbers(schedule, kappa=full["kappa"], lam=full["lam"], fidelity=full.get("fidelity"))
        shadow = Configuration().shadow_schedule
        if "shadow_pass" in self._cascades:
            shadow = Schedule.uniform(self.levels(full, "shadow_pass"), norm=full.get("norm", "l2"))
            shadow = with_numbers(shadow, kappa=full["shadow_kappa"]).check()
            shadow = dataclasses.replace(shadow, name=f"{name}-shadow")
        schedules: dict[str, Any] = {"schedule": schedule.check(), "shadow_schedule": shadow}
        if self.paper:
            return dataclasses.replace(Configuration.paper(), name=name, **schedules)
        if full["guide"] in ("rgb", NO_GUIDE):
            full.pop("guide_size", None)
        options = {n: full[n] for n, choice in CHOICES.items() if n in full and choice.part not in CASCADES}
        return dataclasses.replace(Configuration(), name=name, **schedules).with_choices(options).check()


def _known(values: Mapping[str, Any], space: Space) -> Choices:
    """Values of choices without cascades that have a level which the space does not."""
    kept: Choices = dict(values)
    for name in ("cascade", "shadow_pass"):
        factors = {p.factor for p in space.parameters if p.cascade == name}
        if name in kept and not {factor for factor, count in levels_of(kept[name]) if count} <= factors:
            del kept[name]
    return kept


def _cascade_of(name: str) -> str:
    """Name of the steps of the cascade that a choice is a number of; empty for one that is of no cascade."""
    part = CHOICES[name].part
    return next((n for n, row in CHOICES.items() if row.field == f"{part}.steps"), "") if part in CASCADES else ""


def levels_of(text: str) -> Levels:
    """Levels of a cascade from their text.

    >>> levels_of("16:3 8:4"), levels_of("none")
    (((16, 3), (8, 4)), ((4, 0),))
    """
    if text == NO_STEPS:
        return BARE_LEVELS
    try:
        return tuple((int(factor), int(steps)) for factor, steps in (level.split(":") for level in text.split()))
    except (AttributeError, ValueError):
        raise InputError(f"choices: cascade {text!r:.60}: must be levels as in 16:3 8:4") from None


@functools.cache
def _allowed(sampling: int, cascade: str, shadow_pass: str, data_term: bool) -> int:
    """Sampling that the cascades allow."""
    schedule = Schedule.uniform(levels_of(cascade), fidelity=1.0 if data_term else None)
    return largest_sampling([schedule, Schedule.uniform(levels_of(shadow_pass))], sampling)


def structure(choices: Mapping[str, Any], space: Space) -> str:
    """Key of the choices that decide the time: all but the numbers of ranges."""
    return repr([(p.name, choices[p.name]) for p in space.parameters if not p.continuous and p.name in choices])


def key_of(choices: Mapping[str, Any]) -> str:
    """Key of choices: the same for the same."""
    return repr(sorted(choices.items()))
