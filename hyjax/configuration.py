"""Configuration: all choices of how a frame is relit that cost time or quality, as one file."""

import dataclasses
import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from hyjax.core.cascade import largest_sampling
from hyjax.core.schedule import PAPER_KAPPA, Schedule
from hyjax.pipeline import Mode
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.reading import parse_json, read_text

_log = logging.getLogger(__name__)
SUFFIX = ".json"
DEFAULT = "default"
FOLDER = Path(__file__).with_name("configurations")
PRESETS = ("quality", "balanced", "fast")
"""Configurations that come with hyjax, chosen by `hyjax tune` over rooms of known truth."""
NO_GUIDE = "none"
Scale = Annotated[int, msgspec.Meta(ge=1, le=8)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the parts of a configuration."""


class LightOptions(Options, frozen=True, kw_only=True):
    """How light on the surface is computed.

    Attributes:
        sampling: light at one pixel in each block of so many by so many, see `View.shade`.
        photo_light: whether the light that the frames were taken under is divided out, or kept.
        bounces: whether light that surfaces send on is added, where the photo's light is divided out.
        photo_exponent: exponent of E_old / K before it is divided by: above 1 where its estimate is too even.
        bounce_gain: factor of the bounces.
    """

    sampling: Annotated[int, msgspec.Meta(ge=1, le=16)] = 2
    photo_light: Literal["divided", "kept"] = "divided"
    bounces: bool = True
    photo_exponent: Annotated[float, msgspec.Meta(ge=0, le=4)] = 1.0
    bounce_gain: Annotated[float, msgspec.Meta(ge=0, le=4)] = 1.0


class ShadowOptions(Options, frozen=True, kw_only=True):
    """How shadows are computed. The cascade for them is `Configuration.shadow_schedule`.

    Attributes:
        map_scale: of the shadow maps' resolution, see `cast_shadow_maps`.
        views: of a soft light, at most; None for all that it has.
        least_share: a light that gives the surface a smaller share of its light than this casts no shadow.
    """

    map_scale: Annotated[float, msgspec.Meta(ge=0.05, le=4)] = 1.0
    views: Annotated[int, msgspec.Meta(ge=1)] | None = None
    least_share: Share = 0.0


class GuideOptions(Options, frozen=True, kw_only=True):
    """What guides the diffusion.

    Attributes:
        name: `rgb`, `none` (diffusion without edges), a network that comes with hyjax, or a safetensors file.
        size: longer side, in pixels, that a network sees, at least; None for the frame's.
        every: a network sees one frame of so many; its features are carried to the next by the surface's motion.
            Of a run with `video` alone.
    """

    name: str = "rgb"
    size: Annotated[int, msgspec.Meta(ge=32)] | None = None
    every: Annotated[int, msgspec.Meta(ge=1, le=64)] = 1


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """Where a configuration was measured, and what it took.

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


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=False):
    """Content of a configuration's file."""

    format: Literal[1]
    name: str = "custom"
    mode: Mode = "linear"
    scale: Scale = 1
    schedule: dict[str, Any]
    shadow_schedule: dict[str, Any]
    light: LightOptions = LightOptions()
    shadows: ShadowOptions = ShadowOptions()
    guide: GuideOptions = GuideOptions()
    measured: Measured | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Configuration:
    """How a frame is relit: the default as it is made.

    Attributes:
        name: what tables call it.
        schedule: cascade for the shading.
        shadow_schedule: cascade for the visibility; one of no steps at all leaves the shadow pass out.
        mode: of `relight`.
        scale: the frame is relit at its size over this, and the filter brought to full size under the frame.
        light: how light on the surface is computed.
        shadows: how shadows are.
        guide: what guides the diffusion.
        measured: where it was measured; None if it never was.

    Example:
        >>> again = Configuration.from_json(Configuration().to_json())
        >>> again.schedule.name, again.light.sampling
        ('hyjax', 2)
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

    @classmethod
    def paper(cls) -> "Configuration":
        """The paper's own form: display values, holes black, the photo's light left in."""
        return cls(
            name="paper",
            schedule=Schedule.preset("paper-80", kappa=PAPER_KAPPA),
            shadow_schedule=Schedule.preset("shadow"),
            mode="paper",
            light=LightOptions(sampling=1, photo_light="kept"),
        )

    @classmethod
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
            raise InputError(
                f"configuration: no preset {name!r}{did_you_mean(name, known)}; there are {', '.join(known)}"
            )
        return cls.from_json((FOLDER / f"{name}{SUFFIX}").read_text(encoding="utf-8"))

    @classmethod
    def open_linear(cls, text: str | None, where: str) -> "Configuration":
        """`open`, or the default, for what does not show the paper's form.

        Args:
            text: name or file; None for the default.
            where: what does not show it, for the message.

        Raises:
            InputError: see `open`; or it is of the paper's form.
        """
        chosen = cls.open(text or DEFAULT)
        if chosen.mode == "paper":
            raise InputError(f"configuration {chosen.name}: is of the paper's form, {where}")
        return chosen

    @property
    def sampling(self) -> int:
        """Sampling that its schedules allow."""
        if self.mode == "paper":
            return 1
        return largest_sampling([self.schedule, self.shadow_schedule], self.light.sampling)

    def check(self) -> "Configuration":
        """The configuration, if a frame can be relit by it.

        Raises:
            InputError: a schedule that cannot be run, a value out of range, or choices that exclude each other.
        """
        where = f"configuration {self.name!r}"
        try:
            for part in (self.light, self.shadows, self.guide):
                msgspec.convert(msgspec.to_builtins(part), type(part))
            msgspec.convert(self.scale, Scale)
        except msgspec.ValidationError as error:
            raise InputError(f"{where}: {error}") from None
        for schedule in (self.schedule, self.shadow_schedule):
            schedule.check()
        if self.mode == "paper" and (self.scale != 1 or self.light.photo_light != "kept"):
            raise InputError(f"{where}: mode 'paper' keeps the photo's light and works at full size (scale 1)")
        return self

    def tell_unused(self, where: str, used: Sequence[str]) -> list[str]:
        """A line in the log on choices that are not the default's and that something does not follow; their names.

        Args:
            where: what does not follow them.
            used: names of the choices that it follows; `guide` stands for its name and size.
        """
        default, unused = Configuration(), []
        for part in ("light", "shadows"):
            own, usual = getattr(self, part), getattr(default, part)
            fields = own.__struct_fields__
            unused += [f for f in fields if f not in used and getattr(own, f) != getattr(usual, f)]
        for name in ("schedule", "shadow_schedule"):
            own, usual = (json.loads(getattr(each, name).to_json()) | {"name": ""} for each in (self, default))
            unused += [name] * (name not in used and own != usual)
        unused += ["guide"] * ("guide" not in used and self.guide.name != default.guide.name)
        unused += ["guide every"] * ("every" not in used and self.guide.every != 1)
        unused += ["scale"] * ("scale" not in used and self.scale != 1)
        if unused:
            _log.warning("%s: does not follow %s of configuration %s", where, ", ".join(unused), self.name)
        return unused

    def to_json(self) -> str:
        """The configuration as JSON text; `from_json` reads it."""
        file = _File(
            format=1,
            name=self.name,
            mode=self.mode,
            scale=self.scale,
            schedule=json.loads(self.schedule.to_json()),
            shadow_schedule=json.loads(self.shadow_schedule.to_json()),
            light=self.light,
            shadows=self.shadows,
            guide=self.guide,
            measured=self.measured,
        )
        return msgspec.json.format(msgspec.json.encode(file), indent=2).decode()

    @classmethod
    def from_json(cls, text: str | bytes) -> "Configuration":
        """Read what `to_json` wrote.

        >>> Configuration.from_json('{"format": 1}')
        Traceback (most recent call last):
        hyjax.util.errors.InputError: configuration: ...

        Raises:
            InputError: not JSON, a field missing, unknown or out of range, or anything `check` refuses.
        """
        content = parse_json(text, "configuration", only_finite=True)
        try:
            file = msgspec.convert(content, _File, str_keys=True)
        except msgspec.ValidationError as error:
            hint = "; it is a schedule: give it as --schedule" if '"levels"' in str(text)[:400] else ""
            raise InputError(f"configuration: {error}{hint}") from None
        own, shadow = (_schedule(file, part) for part in ("schedule", "shadow_schedule"))
        return cls(
            file.name, own, shadow, file.mode, file.scale, file.light, file.shadows, file.guide, file.measured
        ).check()

    @classmethod
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


def _schedule(file: _File, part: str) -> Schedule:
    try:
        return Schedule.from_json(json.dumps(getattr(file, part)))
    except InputError as error:
        raise InputError(f"configuration, {part}: {error}") from None
