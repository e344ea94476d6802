"""Configuration: all choices of how a frame is relit that cost time or quality, as one file."""

import dataclasses
import functools
import json
import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from hyjax.choices.choice import RENDERERS, Renderer
from hyjax.choices.options import (
    OPTIONS,
    GuideOptions,
    LightOptions,
    Options,
    ShadowOptions,
    annotated,
    kinds,
    value_of_schedule,
    wanted,
)
from hyjax.choices.table import CASCADES, CHOICES, choice_named
from hyjax.core.cascade import LEAST_SAMPLES, largest_sampling, sampled_schedule
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.light.view import USUAL_PIXELS
from hyjax.pipeline import Mode
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError, did_you_mean, shown
from hyjax.util.reading import parse_json, read_text

_log = logging.getLogger(__name__)
SUFFIX = ".json"
DEFAULT, CUSTOM = "default", "custom"
"""Names of the configuration as it is made, and of one that has changed."""
FOLDER = Path(__file__).with_name("configurations")
PRESETS = ("quality", "balanced", "fast")
"""Configurations that come with hyjax, chosen by `hyjax tune` over rooms of known truth."""


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """Measured times of a configuration, with device and size.

    Attributes:
        device: processor or graphics processor.
        cores: that the process might use.
        size: height and width of the frames.
        median_ms, p95_ms: of a whole frame.
        default_ms: median of the default configuration, in turns with it.
    """

    device: str
    cores: int
    size: tuple[int, int]
    median_ms: float
    p95_ms: float
    default_ms: float | None = None


@dataclasses.dataclass(frozen=True)
class Configuration:
    """Choices by which a frame is relit: the default as it is made.

    Attributes:
        name: what tables call it.
        schedule: cascade for the shading.
        shadow_schedule: cascade for the visibility; one of no steps at all leaves the shadow pass out.
        mode: of `relight`.
        scale: the frame is relit at its size over this, a large one at less; see `scale_of`.
        light: how light on the surface is computed. Its sampling is at most what the schedules allow.
        shadows: how shadows are.
        guide: what guides the diffusion.
        measured: where it was measured; None if it never was.

    Example:
        >>> again = Configuration.from_json(Configuration().to_json())
        >>> again.schedule.name, again.light.sampling
        ('hyjax', 2)
        >>> Configuration().with_choices({"bounces": False, "scale": 2}).light
        LightOptions(bounces=False)
    """

    name: str = DEFAULT
    schedule: Schedule = dataclasses.field(default_factory=lambda: Schedule.preset("hyjax"))
    shadow_schedule: Schedule = dataclasses.field(default_factory=lambda: Schedule.preset("hyjax-scan-shadow"))
    mode: Mode = "linear"
    scale: int = 1
    light: LightOptions = dataclasses.field(default_factory=LightOptions)
    shadows: ShadowOptions = dataclasses.field(default_factory=ShadowOptions)
    guide: GuideOptions = dataclasses.field(default_factory=GuideOptions)
    measured: Measured | None = None

    def __post_init__(self) -> None:
        asked = self.light.sampling if isinstance(self.light, LightOptions) else 1
        if isinstance(asked, int) and asked > 1:
            paper = isinstance(self.mode, str) and self.mode == "paper"
            allowed = 1 if paper else largest_sampling([self.schedule, self.shadow_schedule], asked)
            if allowed < asked:
                object.__setattr__(self, "light", self.light.replace(sampling=allowed))

    @classmethod
    def paper(cls) -> "Configuration":
        """The paper's own form: display values, holes black, the photo's light left in."""
        schedules = Schedule.preset("paper-80", kappa=PAPER_KAPPA), Schedule.preset("shadow")
        return cls("paper", *schedules, mode="paper", light=LightOptions(sampling=1, photo_light="kept"))

    @classmethod
    @checked_arguments
    def preset(cls, name: str) -> "Configuration":
        """A configuration by name: `default`, `paper`, or one of `PRESETS`.

        Raises:
            InputError: there is none of this name.
        """
        if name == DEFAULT:
            return cls()
        if name == "paper":
            return cls.paper()
        if name not in PRESETS:
            known = (DEFAULT, "paper", *PRESETS)
            there_are = f"there are {', '.join(known)}, and files as NAME{SUFFIX}"
            raise InputError(f"configuration: no preset {name!r}{did_you_mean(name, known)}; {there_are}")
        return cls.from_json((FOLDER / f"{name}{SUFFIX}").read_text(encoding="utf-8"))

    @classmethod
    def of(cls, configuration: "Configuration | Schedule | str | Path | None") -> "Configuration":
        """A configuration as it is, by name or file, or the default with another schedule; None for the default.

        Raises:
            InputError: there is none of this name, the file or the configuration cannot be used, or it is none.
        """
        if configuration is None:
            return cls()
        if isinstance(configuration, Schedule):
            return cls(schedule=configuration).check()
        if isinstance(configuration, str | Path):
            return cls.open(str(configuration))
        if not isinstance(configuration, Configuration):
            raise InputError(
                f"configuration: must be a Configuration, a name, a file or a Schedule, got {shown(configuration)}"
            )
        return configuration.check()

    @checked_arguments
    def value(self, name: str) -> Any:
        """Value of a choice; of one of a cascade that each level has, a tuple.

        Raises:
            InputError: there is none of this name.
        """
        choice = choice_named(name)
        if choice.part in CASCADES:
            return value_of_schedule(getattr(self, choice.part), choice.key)
        return getattr(getattr(self, choice.part) if choice.part else self, choice.key)

    def values(self) -> dict[str, Any]:
        """Values of all active choices, in the order of the table."""
        found = {name: self.value(name) for name in CHOICES}
        return {name: value for name, value in found.items() if CHOICES[name].active(found)}

    def scale_of(self, shape: tuple[int, int]) -> int:
        """Factor by which a frame of that height and width is smaller, but for the sampling; 1 in the paper's form.

        >>> [Configuration().scale_of(shape) for shape in ((512, 512), (960, 1280), (1440, 1920))]
        [1, 2, 3]
        """
        return self.scale * (1 if self.mode == "paper" else max(1, math.isqrt(shape[0] * shape[1] // USUAL_PIXELS)))

    @property
    def interleave(self) -> int:
        """Side of the blocks of pixels that share the views of a soft shadow; no cell is smaller."""
        return 1 if self.light.sampling == 1 else LEAST_SAMPLES

    def sampled(self) -> "Configuration":
        """The configuration that frames are relit by: at their size over the sampling, each pixel with its light.

        >>> own = Configuration().sampled()
        >>> own.scale, own.light.sampling, [level.factor for level in own.schedule.levels]
        (2, 1, [8, 4, 2])
        """
        return self if self.light.sampling == 1 else self._sampled

    @functools.cached_property
    def _sampled(self) -> "Configuration":
        sampling = self.light.sampling
        cascades: dict[str, Any] = {part: sampled_schedule(getattr(self, part), sampling) for part in CASCADES}
        light = self.light.replace(sampling=1)
        return dataclasses.replace(self, scale=sampling * self.scale, light=light, **cascades)

    @checked_arguments
    def with_choices(self, values: Mapping[str, Any]) -> "Configuration":
        """The configuration with other values of choices by name; text is read as that of an option.

        One of hyjax that has changed is called "custom"; none that has changed was measured.

        Raises:
            InputError: there is no such choice, it is one of a cascade's, or a value that it cannot have.
        """
        found: dict[str, Any] = {}
        for name, value in values.items():
            choice = choice_named(name)
            if choice.part in CASCADES:
                raise InputError(f"choices: {name} is one of the {choice.part}'s; give another {choice.part}")
            if isinstance(value, np.generic):
                value = value.item()
            if value == "none" and choice.default is None:
                value = None
            try:
                value = msgspec.convert(value, annotated(choice), strict=not isinstance(value, str))
            except msgspec.ValidationError:
                raise InputError(f"choices: {name} must be {wanted(choice)}, got {value!r}") from None
            if choice.part:
                own = found.get(choice.part, getattr(self, choice.part))
                found[choice.part] = own.replace(**{choice.key: value})
            else:
                found[choice.key] = value
        changed = dataclasses.replace(self, **found)
        if changed == self:
            return self
        name = CUSTOM if self.name in (DEFAULT, "paper", *PRESETS) else self.name
        return dataclasses.replace(changed, name=name, measured=None)

    def check(self) -> "Configuration":
        """The configuration, if a frame can be relit by it.

        Raises:
            InputError: a schedule that cannot be run, a value out of range, or choices that exclude each other.
        """
        where = f"configuration {self.name!r}"
        try:
            for part, kind in kinds().items():
                value = getattr(self, part)
                msgspec.convert(value.values() if isinstance(value, Options) else value, kind)
        except msgspec.ValidationError as error:
            raise InputError(f"{where}: {error}") from None
        for schedule in (self.schedule, self.shadow_schedule):
            schedule.check()
        if self.mode == "paper" and (self.scale != 1 or self.light.photo_light != "kept"):
            raise InputError(f"{where}: mode 'paper' keeps the photo's light and works at full size (scale 1)")
        return self

    @checked_arguments
    def followed_by(self, renderer: Renderer, *, say: bool = True) -> "Configuration":
        """The configuration as a renderer follows it: with what it draws for each choice that it does not know.

        Args:
            renderer: whose picture it is.
            say: whether a line in the log says what is not followed.

        Raises:
            InputError: it asks for what the renderer refuses.
        """
        default, unknown, usual = Configuration(), list[str](), dict[str, Any]()
        for name, choice in CHOICES.items():
            if choice.ignored_by(renderer) and choice.unfollowed is not None:
                usual[name] = choice.unfollowed
            elif self.value(name) == default.value(name):
                continue
            elif renderer in choice.refused:
                said = f"{name} {self.value(name)} is not for {RENDERERS[renderer]}"
                raise InputError(f"configuration {self.name}: {said}; leave one of the two out")
            elif choice.ignored_by(renderer):
                unknown.append(name)
        if unknown and say:
            words = self.name, RENDERERS[renderer], ", ".join(unknown)
            _log.warning("configuration %s: not followed by %s: %s", *words)
        cascades = {CHOICES[name].part for name in unknown} & set(CASCADES)
        usual |= {name: default.value(name) for name in unknown if CHOICES[name].part not in CASCADES}
        known = self.with_choices(usual) if usual else self
        return dataclasses.replace(
            known, name=self.name, measured=self.measured, **{part: getattr(default, part) for part in cascades}
        )

    def to_json(self) -> str:
        """The configuration as JSON text; `from_json` reads it."""
        content: dict[str, Any] = {"format": 1, "name": self.name}
        for part in kinds():
            value = getattr(self, part)
            content[part] = value.values() if isinstance(value, Options) else value
        for part in CASCADES:
            content[part] = json.loads(getattr(self, part).to_json())
        content["measured"] = self.measured
        return msgspec.json.format(msgspec.json.encode(content), indent=2).decode()

    @classmethod
    def from_json(cls, text: str | bytes) -> "Configuration":
        """Configuration of the text that `to_json` writes.

        >>> Configuration.from_json('{"format": 1}')
        Traceback (most recent call last):
        hyjax.util.errors.InputError: configuration: ...

        Raises:
            InputError: not JSON, a field missing, unknown or out of range, or anything `check` refuses.
        """
        content = parse_json(text, "configuration", only_finite=True)
        try:
            file: Any = msgspec.convert(content, _file(), str_keys=True)
        except msgspec.ValidationError as error:
            hint = "; it is a schedule: give it as --schedule" if '"levels"' in str(text)[:400] else ""
            if "unknown field" in str(error):
                hint += "; a choice of your own must be registered before its file is read"
            raise InputError(f"configuration: {error}{hint}") from None
        fields: dict[str, Any] = {"name": file.name, "measured": file.measured}
        for part in kinds():
            value, options = getattr(file, part), OPTIONS.get(part)
            fields[part] = value if options is None else options(**msgspec.structs.asdict(value))
        for part in CASCADES:
            fields[part] = _schedule(getattr(file, part), part)
        return cls(**fields).check()

    @classmethod
    @checked_arguments
    def open(cls, text: str) -> "Configuration":
        """A configuration by name or from a file.

        Raises:
            InputError: no such preset, or a file that cannot be read or used.
        """
        if not text.lower().endswith(SUFFIX):
            return cls.preset(text)
        content = read_text(Path(text), f"configuration {text}")
        try:
            return cls.from_json(content)
        except InputError as error:
            raise InputError(f"{text}: {error}") from None


def _schedule(content: dict[str, Any], part: str) -> Schedule:
    try:
        return Schedule.from_json(json.dumps(content))
    except InputError as error:
        raise InputError(f"configuration, {part}: {error}") from None


def _file() -> type[msgspec.Struct]:
    """Content of a configuration's file."""
    default = Configuration()
    fields: list[Any] = [("format", Literal[1]), ("schedule", dict[str, Any]), ("shadow_schedule", dict[str, Any])]
    fields += [("name", str, CUSTOM), ("measured", Measured | None, None)]
    for part, kind in kinds().items():
        fields.append((part, kind, kind() if part in OPTIONS else getattr(default, part)))
    return msgspec.defstruct("file", fields, frozen=True, kw_only=True, forbid_unknown_fields=True)
