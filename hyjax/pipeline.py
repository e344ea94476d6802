"""One frame, whole: G-buffer + lights + frame + guide + schedule → relit picture.

Order, as in the paper: shade the mesh without shadows, repair the shading by the cascade, refine the visibility in
a pass of its own, multiply the two, multiply with the frame. Diffusion is linear and every light has one colour, so
in our own mode each light is a single channel of both passes: shading and shadow of one light never mix with those
of another, and a sun that is mostly shadowed leaves no trace in what the sky lights.

Missing surface and missing light are never confused: a hole has no shading and no visibility of its own, and takes
both on from its surroundings; so does the visibility of a light on surfaces turned away from it, which may in truth
well be lit or shadowed as their neighbours are.
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.cascade import cascade
from hyjax.color import to_display, to_linear
from hyjax.compositing import composite
from hyjax.errors import InputError
from hyjax.gbuffer import GBuffer
from hyjax.lights import AmbientLight, Light
from hyjax.refine import cascade_known, fill_visibility, shadow_pass
from hyjax.schedule import Schedule
from hyjax.shading import colored, shade_each
from hyjax.shadow import ShadowMap, visibilities
from hyjax.values import concrete

Mode = Literal["hyjax", "paper"]
Settle = Callable[
    [Float[Array, "h w l"], Float[Array, "h w l"]], tuple[Float[Array, "h w l"], Float[Array, "h w l"]]
]

# Illuminance under which the frame is taken to have been photographed: an ordinary room in daylight or lamplight.
REFERENCE_LUX = 300.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Relit:
    """What `relight` made of a frame. Filters are linear in mode `hyjax`, display-encoded in mode `paper`.

    Attributes:
        shading: raw relight filter R without shadows; zero where the mesh has no surface.
        refined: the filter after the cascade, without shadows.
        visibility: what the refined shadows leave of it, in [0, 1].
        relight_filter: refined filter with refined shadows: what the frame is multiplied with.
        unrefined: the frame times the raw filter with its raw shadows, to compare with; linear.
        image: the relit frame; linear.
    """

    shading: Float[Array, "h w 3"]
    refined: Float[Array, "h w 3"]
    visibility: Float[Array, "h w 3"]
    relight_filter: Float[Array, "h w 3"]
    unrefined: Float[Array, "h w 3"]
    image: Float[Array, "h w 3"]


def relight(
    frame: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    lights: Sequence[Light],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    *,
    shadow_maps: Sequence[ShadowMap | None] | None = None,
    shading: Float[Array, "h w l"] | None = None,
    visibility: Float[Array, "h w l"] | None = None,
    confidence: Float[Array, "h w 1"] | None = None,
    shadow_schedule: Schedule | None = None,
    reference_lux: Float[ArrayLike, ""] = REFERENCE_LUX,
    settle: Settle | None = None,
    mode: Mode = "hyjax",
) -> Relit:
    """Relight one camera frame.

    Args:
        frame: camera picture, linear.
        gbuffer: what the frame's camera sees of the mesh.
        lights: virtual lights, in the mesh's world coordinates.
        guide: features that say where light may flow; the display-encoded frame itself is the "RGB guide".
        schedule: cascade for the shading.
        shadow_maps: one for each light (None: casts no shadow); None for no shadows at all.
        shading: lux that each light throws on the visible surface, rendered elsewhere; default `shade_each`.
        visibility: what shadows leave of each light, in [0, 1], rendered elsewhere, instead of the shadow maps.
        confidence: how far the shading of each pixel can be trusted, in [0, 1]; default: 1 where the mesh has a
            surface, 0 in holes, which always have none. Mode `"paper"` trusts everything.
        shadow_schedule: cascade for the visibility; default the preset `hyjax-shadow`, in mode `"paper"` `shadow`.
        reference_lux: illuminance under which the frame is taken to have been photographed. Light of this strength
            leaves the frame as it is.
        settle: called with the refined shading and visibility of each light; returns what to take instead. See
            `hyjax.video`; not in mode `"paper"`.
        mode: `"hyjax"` multiplies linear light and treats pixels without surface as unknown; `"paper"` clips and
            display-encodes the filter, leaves holes black, and multiplies display values.

    Returns:
        All stages; `image` and `unrefined` are linear in both modes.

    Raises:
        InputError: sizes differ, no lights, another number of shadow maps or channels than lights, both shadow maps
            and visibility, unknown mode, or a schedule that cannot be run.

    Warns:
        UserWarning: nothing of the frame is known. The relit frame is then what the ambient lights make of it; the
            frame itself if there are none (in mode `"paper"`: black).
    """
    *_, (_, relit) = relight_stages(
        frame,
        gbuffer,
        lights,
        guide,
        schedule,
        shadow_maps=shadow_maps,
        shading=shading,
        visibility=visibility,
        confidence=confidence,
        shadow_schedule=shadow_schedule,
        reference_lux=reference_lux,
        settle=settle,
        mode=mode,
    )
    return relit


def relight_stages(
    frame: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    lights: Sequence[Light],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    *,
    shadow_maps: Sequence[ShadowMap | None] | None = None,
    shading: Float[Array, "h w l"] | None = None,
    visibility: Float[Array, "h w l"] | None = None,
    confidence: Float[Array, "h w 1"] | None = None,
    shadow_schedule: Schedule | None = None,
    reference_lux: Float[ArrayLike, ""] = REFERENCE_LUX,
    settle: Settle | None = None,
    mode: Mode = "hyjax",
) -> Iterator[tuple[str, Any]]:
    """`relight` stage by stage: yields each stage's name with what it made, and last ("composite", `Relit`).

    For whoever wants to time, look at or stop between the stages. Arguments and errors are those of `relight`.
    """
    if mode not in get_args(Mode):
        raise InputError(f"mode: {mode!r} is unknown; use one of {', '.join(get_args(Mode))}")
    if settle is not None and mode == "paper":
        raise InputError("relight: settle works on channels of lights, which mode 'paper' does not have")
    if not lights:
        raise InputError("relight: no lights; give at least one")
    size = frame.shape[:2]
    if gbuffer.hit.shape != size or guide.shape[:2] != size:
        raise InputError(
            f"relight: frame {size}, G-buffer {gbuffer.hit.shape} and guide {guide.shape[:2]} must be of one size"
        )
    for name, given in (("shading", shading), ("visibility", visibility)):
        if given is not None and given.shape != (*size, len(lights)):
            raise InputError(
                f"relight: {name} is {given.shape}, must be {(*size, len(lights))}: a channel for each light"
            )
    if shadow_maps is not None and visibility is not None:
        raise InputError("relight: give shadow maps or the visibility itself, not both")
    maps = (None,) * len(lights) if shadow_maps is None else tuple(shadow_maps)
    if len(maps) != len(lights):
        raise InputError(f"relight: {len(maps)} shadow maps for {len(lights)} lights; give one each, or None")
    lights = tuple(lights)
    if confidence is not None and confidence.shape != (*size, 1):
        raise InputError(f"relight: confidence is {confidence.shape}, must be {(*size, 1)}")
    if shadow_schedule is None:
        shadow_schedule = Schedule.preset("shadow" if mode == "paper" else "hyjax-shadow")
    for used in (schedule, shadow_schedule):
        used.check(dtype=gbuffer.depth.dtype if shading is None else shading.dtype)
    trust: Array = gbuffer.hit[..., None]
    if confidence is not None and mode == "hyjax":
        trust = jnp.where(trust, confidence, 0.0)
    anything = concrete(jnp.any(trust > 0))
    if anything is not None and not anything:
        left = "the relit frame is black" if mode == "paper" else "only ambient light is used"
        warnings.warn(f"relight: nothing of the frame is known; {left}", stacklevel=3)

    def see() -> Float[Array, "h w l"]:
        return visibilities(gbuffer, lights, maps) if visibility is None else visibility

    each = shade_each(gbuffer, lights) if shading is None else shading
    stages = _paper_stages if mode == "paper" else functools.partial(_stages, settle)
    yield from stages(frame, trust, each, see, lights, guide, schedule, shadow_schedule, reference_lux)


def _stages(
    settle: Settle | None,
    frame: Float[Array, "h w 3"],
    trust: Float[Array, "h w 1"] | Bool[Array, "h w 1"],
    each: Float[Array, "h w l"],
    see: Callable[[], Float[Array, "h w l"]],
    lights: Sequence[Light],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    shadow_schedule: Schedule,
    reference_lux: Float[ArrayLike, ""],
) -> Iterator[tuple[str, Any]]:
    """Our mode: a channel for each light, holes unknown, linear light."""
    yield "shading", each
    seen = see()
    yield "visibility", seen
    refined = cascade_known(each, trust, guide, schedule)
    yield "cascade", refined
    refined_seen = shadow_pass(fill_visibility(seen, (each > 0) & (trust > 0), guide), guide, shadow_schedule)
    yield "shadow pass", refined_seen
    if settle is not None:
        refined, refined_seen = settle(refined, refined_seen)
        yield "settle", (refined, refined_seen)
    channels = each, seen, refined, refined_seen
    yield "composite", _composite_channels(frame, *channels, trust, lights, reference_lux)


@jax.jit
def _composite_channels(
    frame: Float[Array, "h w 3"],
    each: Float[Array, "h w l"],
    seen: Float[Array, "h w l"],
    refined: Float[Array, "h w l"],
    refined_seen: Float[Array, "h w l"],
    trust: Float[Array, "h w 1"] | Bool[Array, "h w 1"],
    lights: Sequence[Light],
    reference_lux: Float[ArrayLike, ""],
) -> Relit:
    raw, raw_shadowed, unshadowed, relight_filter = (
        colored(channels, lights) / reference_lux
        for channels in (each, each * seen, refined, refined * refined_seen)
    )
    anything, ambient = jnp.any(trust > 0), _ambient(lights, reference_lux)
    unshadowed, relight_filter = (jnp.where(anything, f, ambient) for f in (unshadowed, relight_filter))
    visible = _ratio(relight_filter, unshadowed)
    unrefined, image = composite(raw_shadowed, frame), composite(relight_filter, frame)
    return Relit(raw, unshadowed, visible, relight_filter, unrefined, image)


def _ambient(lights: Sequence[Light], reference_lux: Float[ArrayLike, ""]) -> Float[Array, "3"]:
    """The filter of the lights that fall on anything alike; 1, leaving the frame as it is, if there are none."""
    ambient = [light.illuminance * light.color for light in lights if isinstance(light, AmbientLight)]
    return sum(ambient[1:], ambient[0]) / reference_lux if ambient else jnp.ones(3)


def _paper_stages(
    frame: Float[Array, "h w 3"],
    trust: Float[Array, "h w 1"] | Bool[Array, "h w 1"],
    each: Float[Array, "h w l"],
    see: Callable[[], Float[Array, "h w l"]],
    lights: Sequence[Light],
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    shadow_schedule: Schedule,
    reference_lux: Float[ArrayLike, ""],
) -> Iterator[tuple[str, Any]]:
    """The paper: the filter is a rendered picture, clipped and display-encoded, black where there is no mesh."""
    raw = _rendered(each, lights, reference_lux)
    yield "shading", raw
    raw_shadowed = _rendered(each * see(), lights, reference_lux)
    raw_visible = _ratio(raw_shadowed, raw)
    yield "visibility", raw_visible
    refined = cascade(raw, guide, schedule)
    yield "cascade", refined
    visible = shadow_pass(raw_visible, guide, shadow_schedule)
    yield "shadow pass", visible
    yield "composite", _composite_display(frame, raw, raw_shadowed, refined, visible)


@jax.jit
def _rendered(
    each: Float[Array, "h w l"], lights: Sequence[Light], reference_lux: Float[ArrayLike, ""]
) -> Float[Array, "h w 3"]:
    return to_display(colored(each, lights) / reference_lux)


@jax.jit
def _composite_display(
    frame: Float[Array, "h w 3"],
    raw: Float[Array, "h w 3"],
    raw_shadowed: Float[Array, "h w 3"],
    refined: Float[Array, "h w 3"],
    visible: Float[Array, "h w 3"],
) -> Relit:
    display, relight_filter = to_display(frame), refined * visible
    unrefined, image = (to_linear(composite(f, display)) for f in (raw_shadowed, relight_filter))
    return Relit(raw, refined, visible, relight_filter, unrefined, image)


@jax.jit
def _ratio(part: Float[Array, "h w 3"], whole: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """What is left of `whole`, in [0, 1]; 1 where there is nothing to lose."""
    return jnp.where(whole > 0, part / jnp.where(whole > 0, whole, 1.0), 1.0)
