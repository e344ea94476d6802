"""Row of the table of choices."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal

from hyjax.util.errors import InputError

if TYPE_CHECKING:
    from hyjax.light.photo_light import SurfaceLight

Scale = Literal["any", "ordered", "linear", "log", "steps"]
Values = Mapping[str, Any]
"""Value of each choice by name."""
Renderer = Literal["webgpu", "page", "tour", "live tour", "file", "blender", "video", "frames"]
RENDERERS: dict[Renderer, str] = {
    "webgpu": "--renderer webgpu",
    "page": "exported pages",
    "tour": "tours",
    "live tour": "tours of frames as they arrive",
    "file": "files for other runtimes",
    "blender": "--renderer blender",
    "video": "--video",
    "frames": "frames without --video",
}
"""Renderers that do not follow all choices, in words."""
OTHER_RENDERERS: tuple[Renderer, ...] = ("webgpu", "page", "tour", "live tour")


@dataclasses.dataclass(frozen=True)
class Tried:
    """Values of a choice that a search tries.

    Attributes:
        values: each; of a range, (lowest, highest); of a cascade, the factors of its levels.
        start: that of the default configuration; the choice's own default if None.
        scale: of a range: `linear` or `log`; of single values whether neighbours are alike: `ordered`, or `any`; of
            a cascade `steps`: each of its levels may have any number of them.
    """

    values: tuple[Any, ...]
    start: Any = None
    scale: Scale = "any"


@dataclasses.dataclass(frozen=True)
class Choice:
    """One choice.

    Attributes:
        name: in options, files, tables and reports.
        field: its place in a `Configuration`: `light.sampling`, or `schedule.kappa` of a cascade.
        type: of its values; None may be given where it is the default.
        default: value where nothing is said.
        help: one sentence.
        bounds: least and greatest value that may be given.
        label: in reports; its name if empty.
        tried: by the search; None for what is not searched.
        paper: likewise in the paper's form.
        truth: whether only true pictures can judge it.
        active: whether it means anything beside the others.
        said: renderers that do not follow it, and say so where another value than the default is given.
        unfollowed: value that these draw with; None for the default.
        refused: renderers that refuse another value than the default.
        use: the light on the surface as a value makes it, for choices of that light.
    """

    name: str
    field: str
    type: Any
    default: Any
    help: str
    bounds: tuple[float, float] | None = None
    label: str = ""
    tried: Tried | None = None
    paper: Tried | None = None
    truth: bool = False
    active: Callable[[Values], bool] = lambda values: True
    said: tuple[Renderer, ...] = OTHER_RENDERERS
    unfollowed: Any = None
    refused: tuple[Renderer, ...] = ()
    use: "Callable[[SurfaceLight, Any], SurfaceLight] | None" = None

    @property
    def part(self) -> str:
        """Part of a configuration that has it; empty for the configuration itself."""
        return self.field.rpartition(".")[0]

    @property
    def key(self) -> str:
        """Name in its part."""
        return self.field.rpartition(".")[2]

    @property
    def usual_value(self) -> Any:
        """Value that renderers draw with that do not follow it."""
        return self.default if self.unfollowed is None else self.unfollowed

    def followed_by(self, renderer: Renderer) -> bool:
        """Whether a renderer follows every value."""
        return renderer not in self.refused and not self.ignored_by(renderer)

    def ignored_by(self, renderer: Renderer) -> bool:
        """Whether a renderer leaves it out: files hold the cascade of the light alone."""
        return self.part != "schedule" if renderer == "file" else renderer in self.said


def named_values(texts: Iterable[str]) -> dict[str, str]:
    """Values of choices by name, from options as NAME=VALUE.

    >>> named_values(["bounces=false"])
    {'bounces': 'false'}
    """
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"choices: {text!r} has no value; write NAME=VALUE, such as bounces=false")
        if name in values:
            raise InputError(f"choices: {name} is given twice")
        values[name] = value
    return values
