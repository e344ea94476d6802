"""Table of the choices."""

import dataclasses
import functools
from typing import TYPE_CHECKING, Literal

from hyjax.choices.choice import OTHER_RENDERERS, Choice, Tried, Values
from hyjax.core.presets import DEFAULT_KAPPA, GUIDED_FIDELITY, GUIDED_KAPPA, PAPER_KAPPA
from hyjax.core.step_size import DEFAULT_LAM
from hyjax.util.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from hyjax.light.photo_light import SurfaceLight

NO_STEPS = "none"
LARGEST_SCALE = 8
"""Largest factor by which frames are relit smaller, but for the sampling."""
_NORMS = ("l2", "mean_abs")


def _guided(values: Values) -> bool:
    return values["guide"] != "none"


def _learned(values: Values) -> bool:
    return values["guide"] not in ("none", "rgb")


def _divided(values: Values) -> bool:
    return values["photo_light"] == "divided"


def _raised(light: "SurfaceLight", exponent: float) -> "SurfaceLight":
    return light if exponent == 1.0 else light.raised(exponent)


def _bounced(light: "SurfaceLight", bounces: bool) -> "SurfaceLight":
    return light if bounces else dataclasses.replace(light, bounced=None)


def _gained(light: "SurfaceLight", gain: float) -> "SurfaceLight":
    return light if light.bounced is None else dataclasses.replace(light, bounced=gain * light.bounced)


_KAPPA, _LAM, _SHADOW_KAPPA = (Tried(x, scale="log") for x in ((0.005, 0.5), (0.05, 0.2499), (0.002, 0.3)))
PARTS = ("light", "shadows", "guide")
"""Parts of a configuration that have options."""
CASCADES = "schedule", "shadow_schedule"  # of which a choice is one number or word
_followed = functools.partial(Choice, said=())
"""Row of a choice that renderers follow, but for those that refuse it."""
CHOICES: dict[str, Choice] = {}
"""Table of all choices by name, each after those that it depends on."""


def register_choice(choice: Choice) -> None:
    """Add a row to the table.

    Raises:
        InputError: its name or field is taken or cannot be an option's, or the default is out of bounds.
    """
    if choice.part not in PARTS:
        raise InputError(f"choices: {choice.field}: must be in one of {', '.join(f'{part}.' for part in PARTS)}")
    if not choice.key.isidentifier() or choice.key.startswith("_") or choice.key in ("values", "replace", "PART"):
        raise InputError(f"choices: {choice.field}: {choice.key!r} cannot be the name of an option")
    low, high = choice.bounds or (choice.default, choice.default)
    if choice.default is not None and not low <= choice.default <= high:
        raise InputError(f"choices: {choice.name}: its default {choice.default} is not within {low} to {high}")
    for other in CHOICES.values():
        if choice.name == other.name or choice.field == other.field:
            raise InputError(f"choices: {choice.name!r} ({choice.field}) is there already")
    CHOICES[choice.name] = choice


def choice_named(name: str) -> Choice:
    """Choice of a name."""
    if name not in CHOICES:
        raise InputError(
            f"choices: no choice {name!r}{did_you_mean(name, CHOICES)}; there are {', '.join(sorted(CHOICES))}"
        )
    return CHOICES[name]


def options_of(part: str) -> dict[str, Choice]:
    """Choices of a part of a configuration, by their names in it."""
    return {choice.key: choice for choice in CHOICES.values() if choice.part == part}


for _row in (
    _followed(
        "mode",
        "mode",
        Literal["linear", "paper"],
        "linear",
        "Multiply linear light, with holes filled; or exactly the paper: display values, holes black.",
        refused=(*OTHER_RENDERERS, "file", "video"),
    ),
    Choice(
        "scale",
        "scale",
        int,
        1,
        "The frame is relit at its size over this, a large one at less; the filter is brought up under it.",
        bounds=(1, LARGEST_SCALE),
        tried=Tried((1, 2, 3, 4), scale="ordered"),
        said=("page",),
        refused=("webgpu", "blender", "video"),
    ),
    Choice(
        "sampling",
        "light.sampling",
        int,
        2,
        "Light is found and repaired at a picture so many times smaller, as far as the cascades' cells allow it.",
        bounds=(1, 16),
        tried=Tried((1, 2, 4), scale="ordered"),
        said=("webgpu", "page", "blender"),
        unfollowed=1,
    ),
    _followed(
        "cascade",
        "schedule.steps",
        str,
        "16:3 8:4 4:6",
        "Levels of the cascade for the light, coarse to fine, as factor:steps.",
        tried=Tried((16, 8, 4, 2), scale="steps"),
        paper=Tried((16, 8, 4, 2), "16:10 8:15 4:25 2:30", "steps"),
    ),
    _followed(
        "shadow_pass",
        "shadow_schedule.steps",
        str,
        "4:5 1:2",
        "Levels of the cascade for the visibility; none leaves the shadow pass out.",
        tried=Tried((4, 2, 1), scale="steps"),
        paper=Tried((4, 2, 1), "1:8", "steps"),
    ),
    Choice(
        "guide",
        "guide.name",
        str,
        "rgb",
        "Guide of the diffusion: rgb, none, a network that comes with hyjax, or a safetensors file.",
        tried=Tried(("rgb", "none", "small")),
        said=("page",),
    ),
    Choice(
        "guide_size",
        "guide.size",
        int,
        None,
        "Longer side, in pixels, that a network sees, at least; the frame's where nothing is said.",
        bounds=(32, 2**31),
        tried=Tried((128, 256, 512), 256, "ordered"),
        active=_learned,
        said=("page",),
    ),
    Choice(
        "guide_every",
        "guide.every",
        int,
        1,
        "Frames of a video for each that the network sees; the others' features follow the surface's motion.",
        bounds=(1, 64),
        active=_learned,
        said=(*OTHER_RENDERERS, "frames"),
    ),
    _followed(
        "pooling",
        "schedule.pooling",
        Literal["guide", "edges"],
        "guide",
        "Conductances of coarse levels: of the pooled guide, or the least of the fine ones.",
        tried=Tried(("guide", "edges")),
        paper=Tried(("edges", "guide"), "edges"),
        active=_guided,
    ),
    _followed(
        "upsampling",
        "schedule.upsampling",
        Literal["guide", "bilinear"],
        "guide",
        "From level to level along the guide, or bilinear.",
        tried=Tried(("guide", "bilinear")),
        active=_guided,
    ),
    _followed(
        "norm",
        "schedule.norm",
        str,
        "l2",
        "Norm of guide differences.",
        tried=Tried(_NORMS),
        paper=Tried(_NORMS),
        active=_guided,
    ),
    _followed(
        "kappa",
        "schedule.kappa",
        float,
        GUIDED_KAPPA,
        "Edge sensitivity.",
        label="κ",
        tried=_KAPPA,
        paper=dataclasses.replace(_KAPPA, start=PAPER_KAPPA),
        active=_guided,
    ),
    _followed(
        "lam",
        "schedule.lam",
        float,
        DEFAULT_LAM,
        "Step size.",
        label="λ",
        tried=_LAM,
        paper=_LAM,
    ),
    _followed(
        "data_term",
        "schedule.data_term",
        bool,
        True,
        "Whether steps hold on to the cell means of their level.",
        tried=Tried((True, False)),
    ),
    _followed(
        "fidelity",
        "schedule.fidelity",
        float,
        GUIDED_FIDELITY,
        "How much they hold on to them.",
        label="α",
        tried=Tried((0.01, 3.0), scale="log"),
        active=lambda values: values["data_term"],
    ),
    _followed(
        "shadow_kappa",
        "shadow_schedule.kappa",
        float,
        DEFAULT_KAPPA,
        "Edge sensitivity of the shadow pass.",
        label="shadow κ",
        tried=_SHADOW_KAPPA,
        paper=_SHADOW_KAPPA,
        active=lambda values: _guided(values) and values["shadow_pass"] != NO_STEPS,
    ),
    Choice(
        "map_scale",
        "shadows.map_scale",
        float,
        1.0,
        "Resolution of the shadow maps, relative to the usual one.",
        bounds=(0.05, 4.0),
        tried=Tried((0.25, 0.5, 1.0), scale="ordered"),
        said=("webgpu", "blender"),
    ),
    Choice(
        "views",
        "shadows.views",
        int,
        None,
        "Views of a soft light in its shadow map, at most; all that it has where nothing is said.",
        bounds=(1, 2**31),
        tried=Tried((4, 8, 16, None), scale="ordered"),
        said=("webgpu", "page", "blender"),
    ),
    Choice(
        "least_share",
        "shadows.least_share",
        float,
        0.0,
        "A light that gives the surface a smaller share of its light than this casts no shadow.",
        bounds=(0.0, 1.0),
        tried=Tried((0.0, 0.02, 0.05, 0.15), scale="ordered"),
        said=("webgpu", "page", "blender"),
    ),
    Choice(
        "photo_light",
        "light.photo_light",
        Literal["divided", "kept"],
        "divided",
        "Whether the light that the frames were taken under is divided out, or kept.",
        tried=Tried(("divided", "kept")),
        truth=True,
        said=("live tour",),
        refused=("page",),
    ),
    Choice(
        "photo_exponent",
        "light.photo_exponent",
        float,
        1.0,
        "Exponent of E_old / K before it is divided by: above 1 where its estimate is too even.",
        bounds=(0.0, 4.0),
        tried=Tried((0.7, 1.8), scale="log"),
        truth=True,
        active=_divided,
        said=("live tour",),
        use=_raised,
    ),
    Choice(
        "light_edges",
        "light.edges",
        bool,
        True,
        "Whether the photo's own light is sharpened along light edges of the frame, by a small network.",
        tried=Tried((True, False)),
        truth=True,
        active=_divided,
        unfollowed=False,
    ),
    Choice(
        "bounces",
        "light.bounces",
        bool,
        True,
        "Whether light that surfaces send on is added, where the photo's light is divided out.",
        tried=Tried((True, False)),
        truth=True,
        active=_divided,
        said=("webgpu", "page", "live tour"),
        use=_bounced,
    ),
    Choice(
        "bounce_gain",
        "light.bounce_gain",
        float,
        1.0,
        "Factor of the bounces.",
        bounds=(0.0, 4.0),
        tried=Tried((0.4, 2.0), scale="log"),
        truth=True,
        active=lambda values: _divided(values) and values["bounces"],
        said=("webgpu", "page", "live tour"),
        use=_gained,
    ),
):
    CHOICES[_row.name] = _row
