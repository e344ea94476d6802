"""Search space of configurations: what may be chosen, and which choices others depend on."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hyjax.configuration import Configuration, GuideOptions, LightOptions, ShadowOptions
from hyjax.core.schedule import DEFAULT_KAPPA, GUIDED_FIDELITY, GUIDED_KAPPA, PAPER_KAPPA, Schedule
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.util.errors import InputError

Choices = dict[str, Any]
"""Value of each parameter by name; those that are not active are left out."""
Steps = tuple[tuple[int, int], ...]


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One choice.

    Attributes:
        name: what tables call it.
        values: that it may have, in order where it has one; of a range, (lowest, highest).
        default: today's.
        continuous: whether all values between the two of `values` may be taken, on a logarithmic scale.
        ordered: whether neighbouring values are alike.
        active: whether it means anything beside other choices.
    """

    name: str
    values: tuple[Any, ...]
    default: Any
    continuous: bool = False
    ordered: bool = False
    active: Callable[[Mapping[str, Any]], bool] = lambda choices: True

    def holds(self, value: Any) -> bool:
        """Whether it may have a value."""
        if not self.continuous:
            return value in self.values
        low, high = self.values
        return isinstance(value, int | float) and low <= value <= high

    def place(self, value: Any) -> float:
        """Value as a number in [0, 1], in the order of the values."""
        if self.continuous:
            low, high = (math.log(x) for x in self.values)
            return (math.log(value) - low) / (high - low)
        return self.values.index(value) / max(len(self.values) - 1, 1)

    def at(self, place: float) -> Any:
        """Value of a range at a number in [0, 1]."""
        low, high = (math.log(x) for x in self.values)
        return float(np.clip(math.exp(low + place * (high - low)), *self.values))

    def draw(self, rng: np.random.Generator) -> Any:
        """A random value."""
        return self.at(rng.random()) if self.continuous else self.values[int(rng.integers(len(self.values)))]


CASCADES: dict[str, Steps] = {
    "16:3 8:4 4:6": ((16, 3), (8, 4), (4, 6)),
    "8:4": ((8, 4),),
    "4:6": ((4, 6),),
    "8:3 4:3": ((8, 3), (4, 3)),
    "16:3 8:4": ((16, 3), (8, 4)),
    "8:4 4:6 2:4": ((8, 4), (4, 6), (2, 4)),
    "16:6 8:8 4:12": ((16, 6), (8, 8), (4, 12)),
    "16:5 8:10 4:15 2:20": ((16, 5), (8, 10), (4, 15), (2, 20)),
}
SHADOW_CASCADES: dict[str, Steps] = {
    "4:5 1:2": ((4, 5), (1, 2)),
    "none": ((4, 0),),
    "4:2": ((4, 2),),
    "4:2 1:2": ((4, 2), (1, 2)),
    "4:4 2:3": ((4, 4), (2, 3)),
    "2:2": ((2, 2),),
    "1:2": ((1, 2),),
    "4:15 1:4": ((4, 15), (1, 4)),
}
PAPER_CASCADES: dict[str, Steps] = {
    "16:10 8:15 4:25 2:30": ((16, 10), (8, 15), (4, 25), (2, 30)),
    "16:5 8:10 4:15 2:20": CASCADES["16:5 8:10 4:15 2:20"],
    "8:4": CASCADES["8:4"],
    "16:3 8:4 4:6": CASCADES["16:3 8:4 4:6"],
    "2:50": ((2, 50),),
}
PAPER_SHADOWS: dict[str, Steps] = {
    "1:8": ((1, 8),),
    "1:2": ((1, 2),),
    "2:4": ((2, 4),),
    "4:4 1:2": ((4, 4), (1, 2)),
}
UNITS = ("l2", "mean_abs")


def _divided(choices: Mapping[str, Any]) -> bool:
    return choices["photo light"] == "divided"


def _bounced(choices: Mapping[str, Any]) -> bool:
    return _divided(choices) and choices["bounces"]


def _learned(choices: Mapping[str, Any]) -> bool:
    return choices["guide"] == "small"


def _guided(choices: Mapping[str, Any]) -> bool:
    return choices["guide"] != "none"


def _held(choices: Mapping[str, Any]) -> bool:
    return choices["data term"]


_CASCADE = (
    Parameter("pooling", ("guide", "edges"), "guide", active=_guided),
    Parameter("upsampling", ("guide", "bilinear"), "guide", active=_guided),
    Parameter("norm", UNITS, "l2", active=_guided),
    Parameter("kappa", (0.005, 0.5), GUIDED_KAPPA, continuous=True, active=_guided),
    Parameter("lam", (0.05, 0.2499), DEFAULT_LAM, continuous=True),
    Parameter("data term", (True, False), True),
    Parameter("fidelity", (0.01, 3.0), GUIDED_FIDELITY, continuous=True, active=_held),
    Parameter("shadow kappa", (0.002, 0.3), DEFAULT_KAPPA, continuous=True, active=_guided),
)
LINEAR = (
    Parameter("scale", (1, 2, 3, 4), 1, ordered=True),
    Parameter("sampling", (1, 2, 4), 2, ordered=True),
    Parameter("cascade", tuple(CASCADES), "16:3 8:4 4:6"),
    Parameter("shadow pass", tuple(SHADOW_CASCADES), "4:5 1:2"),
    Parameter("guide", ("rgb", "none", "small"), "rgb"),
    Parameter("guide size", (128, 256, 512), 256, ordered=True, active=_learned),
    *_CASCADE,
    Parameter("map scale", (0.25, 0.5, 1.0), 1.0, ordered=True),
    Parameter("views", (4, 8, 16, None), None, ordered=True),
    Parameter("least share", (0.0, 0.02, 0.05, 0.15), 0.0, ordered=True),
)
"""Parameters of linear light."""
PHOTO = (
    Parameter("photo light", ("divided", "kept"), "divided"),
    Parameter("photo exponent", (0.7, 1.8), 1.0, continuous=True, active=_divided),
    Parameter("bounces", (True, False), True, active=_divided),
    Parameter("bounce gain", (0.4, 2.0), 1.0, continuous=True, active=_bounced),
)
"""Of the photo's own light, which only true pictures can judge."""
PAPER = (
    Parameter("cascade", tuple(PAPER_CASCADES), "16:10 8:15 4:25 2:30"),
    Parameter("shadow pass", tuple(PAPER_SHADOWS), "1:8"),
    Parameter("norm", UNITS, "l2"),
    Parameter("pooling", ("edges", "guide"), "edges"),
    Parameter("kappa", (0.005, 0.5), PAPER_KAPPA, continuous=True),
    Parameter("lam", (0.05, 0.2499), DEFAULT_LAM, continuous=True),
    Parameter("shadow kappa", (0.002, 0.3), DEFAULT_KAPPA, continuous=True),
)
"""Of the paper's own form: display values, holes black."""


@dataclasses.dataclass(frozen=True)
class Space:
    """Search space.

    Attributes:
        parameters: each after those that it depends on.
        paper: whether it is of the paper's form.
    """

    parameters: tuple[Parameter, ...]
    paper: bool = False

    @classmethod
    def of(cls, *, truth: bool, paper: bool = False) -> "Space":
        """Space of linear light, or of the paper's form.

        Args:
            truth: whether true pictures judge it.
            paper: the paper's form.
        """
        if paper:
            return cls(PAPER, True)
        return cls((*LINEAR, *PHOTO) if truth else LINEAR)

    @property
    def default(self) -> Choices:
        """Choices of the default configuration."""
        return self.complete({})

    def complete(self, choices: Mapping[str, Any]) -> Choices:
        """Choices with defaults for what is not told, and without what means nothing beside the others.

        Raises:
            InputError: a name or value that is none of the space's.
        """
        known = {parameter.name for parameter in self.parameters}
        if unknown := sorted(choices.keys() - known):
            raise InputError(f"choices: no parameter {unknown[0]!r}; there are {', '.join(sorted(known))}")
        whole = {p.name: choices.get(p.name, p.default) for p in self.parameters}
        kept: Choices = {}
        for parameter in self.parameters:
            value = whole[parameter.name]
            if not parameter.holds(value):
                raise InputError(f"choices: {parameter.name} {value!r} is not among {parameter.values}")
            if parameter.active(whole):
                kept[parameter.name] = value
        return kept

    def random(self, rng: np.random.Generator) -> Choices:
        """Random choices."""
        return self.complete({parameter.name: parameter.draw(rng) for parameter in self.parameters})

    def changes(self, choices: Choices) -> list[Choices]:
        """All choices that differ in one discrete parameter."""
        found: list[Choices] = []
        for parameter in self.parameters:
            if parameter.continuous or parameter.name not in choices:
                continue
            others = [value for value in parameter.values if value != choices[parameter.name]]
            found += [self.complete(choices | {parameter.name: value}) for value in others]
        return found

    def mutated(self, choices: Choices, rng: np.random.Generator, rate: float) -> Choices:
        """Choices of which each is changed with a probability; numbers of ranges by a little."""
        changed = dict(choices)
        for parameter in self.parameters:
            if rng.random() >= rate:
                continue
            if parameter.continuous:
                place = parameter.place(choices.get(parameter.name, parameter.default))
                changed[parameter.name] = parameter.at(place + 0.12 * rng.standard_normal())
            else:
                changed[parameter.name] = parameter.draw(rng)
        return self.complete(changed)

    def configuration(self, choices: Mapping[str, Any], name: str = "tuned") -> Configuration:
        """Configuration of these choices."""
        full = {p.name: p.default for p in self.parameters} | dict(choices)
        cascades, shadows = (PAPER_CASCADES, PAPER_SHADOWS) if self.paper else (CASCADES, SHADOW_CASCADES)
        alike = {"lam": full["lam"], "norm": full["norm"]}
        shadow = Schedule.uniform(shadows[full["shadow pass"]], kappa=full["shadow kappa"], norm=full["norm"])
        own = Schedule.uniform(
            cascades[full["cascade"]],
            kappa=full["kappa"],
            fidelity=full["fidelity"] if full.get("data term") else None,
            pooling=full["pooling"],
            upsampling=full.get("upsampling", "bilinear"),
            name=name,
            **alike,
        )
        shadow = dataclasses.replace(shadow, name=f"{name}-shadow")
        if self.paper:
            return dataclasses.replace(Configuration.paper(), name=name, schedule=own, shadow_schedule=shadow)
        learned = full["guide"] == "small"
        light = LightOptions(
            sampling=full["sampling"],
            photo_light=full.get("photo light", "divided"),
            bounces=full.get("bounces", True),
            photo_exponent=full.get("photo exponent", 1.0),
            bounce_gain=full.get("bounce gain", 1.0),
        )
        options = ShadowOptions(map_scale=full["map scale"], views=full["views"], least_share=full["least share"])
        guide = GuideOptions(name=full["guide"], size=full["guide size"] if learned else None)
        scale = full["scale"]
        return Configuration(name, own, shadow, "linear", scale, light, options, guide).check()


def structure(choices: Mapping[str, Any], space: Space) -> str:
    """Key of what decides on the time: choices without the numbers of ranges."""
    names = [p.name for p in space.parameters if not p.continuous]
    return repr([(name, choices[name]) for name in names if name in choices])


def key_of(choices: Mapping[str, Any]) -> str:
    """Key of choices: the same for the same."""
    return repr(sorted(choices.items()))


def random_configurations(count: int, seed: int, *, truth: bool = True) -> list[Configuration]:
    """Random configurations, the default first; the same for the same seed."""
    space, rng = Space.of(truth=truth), np.random.default_rng(seed)
    drawn: Sequence[Choices] = [space.default, *(space.random(rng) for _ in range(count - 1))]
    return [space.configuration(choices, f"random-{seed}-{n}") for n, choices in enumerate(drawn)][:count]
