"""One frame, whole: G-buffer + lights + frame + guide + schedule → relit picture.

Order, as in the paper: shade the mesh without shadows, repair the shading by the cascade, refine the visibility in
a pass of its own, multiply the two, multiply with the frame. Diffusion is linear and every light has one colour, so
in our own mode each light is a single channel of both passes: shading and shadow of one light never mix with those
of another, and a sun that is mostly shadowed leaves no trace in what the sky lights.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.cascade import cascade
from hyjax.color import to_display, to_linear
from hyjax.compositing import composite
from hyjax.errors import InputError
from hyjax.gbuffer import GBuffer
from hyjax.lights import TINY, Light
from hyjax.pyramid import downsample
from hyjax.schedule import Schedule
from hyjax.shading import colored, shade_each
from hyjax.shadow import ShadowMap, visibilities

Mode = Literal["hyjax", "paper"]

# Illuminance under which the frame is taken to have been photographed: an ordinary room in daylight or lamplight.
REFERENCE_LUX = 300.0

# Weight below which a hole counts as too far from any surface to be filled from its surroundings.
HOLE_FLOOR = 1e-3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
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
    shadow_schedule: Schedule | None = None,
    reference_lux: Float[ArrayLike, ""] = REFERENCE_LUX,
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
        shadow_schedule: cascade for the visibility; default `Schedule.preset("shadow")`.
        reference_lux: illuminance under which the frame is taken to have been photographed. Light of this strength
            leaves the frame as it is.
        mode: `"hyjax"` multiplies linear light and treats pixels without surface as unknown; `"paper"` clips and
            display-encodes the filter, leaves holes black, and multiplies display values.

    Returns:
        All stages; `image` and `unrefined` are linear in both modes.

    Raises:
        InputError: sizes differ, no lights, another number of shadow maps than lights, unknown mode, or a schedule
            that cannot be run.
    """
    *_, (_, relit) = relight_stages(
        frame,
        gbuffer,
        lights,
        guide,
        schedule,
        shadow_maps=shadow_maps,
        shadow_schedule=shadow_schedule,
        reference_lux=reference_lux,
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
    shadow_schedule: Schedule | None = None,
    reference_lux: Float[ArrayLike, ""] = REFERENCE_LUX,
    mode: Mode = "hyjax",
) -> Iterator[tuple[str, Any]]:
    """`relight` stage by stage: yields each stage's name with what it made, and last ("composite", `Relit`).

    For whoever wants to time, look at or stop between the stages. Arguments and errors are those of `relight`.
    """
    if mode not in get_args(Mode):
        raise InputError(f"mode: {mode!r} is unknown; use one of {', '.join(get_args(Mode))}")
    if not lights:
        raise InputError("relight: no lights; give at least one")
    size = frame.shape[:2]
    if gbuffer.hit.shape != size or guide.shape[:2] != size:
        raise InputError(
            f"relight: frame {size}, G-buffer {gbuffer.hit.shape} and guide {guide.shape[:2]} must be of one size"
        )
    maps = (None,) * len(lights) if shadow_maps is None else tuple(shadow_maps)
    if len(maps) != len(lights):
        raise InputError(f"relight: {len(maps)} shadow maps for {len(lights)} lights; give one each, or None")
    lights = tuple(lights)
    shadow_schedule = Schedule.preset("shadow") if shadow_schedule is None else shadow_schedule
    schedule.check(), shadow_schedule.check()

    each = shade_each(gbuffer, lights)
    channels = to_display(colored(each, lights) / reference_lux) if mode == "paper" else each
    yield "shading", channels
    seen = visibilities(gbuffer, lights, maps)
    if mode == "paper":
        seen = shadow_ratio(each, seen, lights)
    yield "visibility", seen
    if mode == "paper":
        refined = cascade(channels, guide, schedule)
    else:
        refined = cascade_known(channels, gbuffer.hit[..., None], guide, schedule)
    yield "cascade", refined
    filled = seen if mode == "paper" else fill_visibility(seen, each > 0, guide, schedule)
    refined_seen = shadow_pass(filled, guide, shadow_schedule)
    yield "shadow pass", refined_seen
    yield "composite", _finish(frame, channels, refined, seen, refined_seen, lights, reference_lux, mode=mode)


@jax.jit
def shadow_ratio(
    each: Float[Array, "h w l"], seen: Float[Array, "h w l"], lights: Sequence[Light]
) -> Float[Array, "h w 3"]:
    """One visibility for all lights together: shadowed over unshadowed shading, for each colour.

    Args:
        each: unshadowed illuminance from each light, from `shade_each`.
        seen: `visibilities` of the lights.
        lights: for their colours.

    Returns:
        Values in [0, 1]; 1 where there is no light to lose.
    """
    return _ratio(colored(each * seen, lights), colored(each, lights))


def _ratio(part: Float[Array, "h w 3"], whole: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    return jnp.where(whole > 0, part / jnp.where(whole > 0, whole, 1.0), 1.0)


@functools.partial(jax.jit, static_argnames="mode")
def _finish(
    frame: Float[Array, "h w 3"],
    each: Float[Array, "h w k"],
    refined: Float[Array, "h w k"],
    seen: Float[Array, "h w k"],
    refined_seen: Float[Array, "h w k"],
    lights: Sequence[Light],
    reference_lux: Float[ArrayLike, ""],
    mode: Mode,
) -> Relit:
    """Channels to filters, and filters times the frame (Eq. 1)."""
    if mode == "paper":
        backdrop, to_filter = to_display(frame), lambda channels: channels
    else:
        backdrop, to_filter = frame, lambda channels: colored(channels, lights) / reference_lux
    relight_filter, unshadowed = to_filter(refined * refined_seen), to_filter(refined)
    image = composite(relight_filter, backdrop)
    unrefined = composite(to_filter(each * seen), backdrop)
    if mode == "paper":
        image, unrefined = to_linear(image), to_linear(unrefined)
    visible = _ratio(relight_filter, unshadowed)
    return Relit(to_filter(each), unshadowed, visible, relight_filter, unrefined, image)


@jax.jit
def cascade_known(
    y: Float[Array, "h w c"], known: Bool[Array, "h w k"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w c"]:
    """`cascade` that treats values outside `known` as missing instead of taking them for real.

    Diffuses (w y, w) with w = 1 on what is known and divides, so that a hole takes on its surroundings' value
    instead of darkening them. Where nothing known is within reach the mean of all that is known stands in.

    Args:
        y: the filter to repair.
        known: where its values mean anything; one channel for all of y's or one for each.
        guide: see `cascade`.
        schedule: see `cascade`.

    Source: Knutsson and Westin, *Normalized and differential convolution*, CVPR 1993.
    """
    weight, channels = known.astype(y.dtype), y.shape[-1]
    weighted = jnp.concatenate([y * weight, weight], axis=-1)
    total = jnp.sum(downsample(weighted, schedule.levels[0].factor), axis=(0, 1))
    mean = total[:channels] / jnp.maximum(total[channels:], TINY)
    diffused = cascade(weighted, guide, schedule)
    reached = diffused[..., channels:]
    floor = HOLE_FLOOR * (1.0 - reached)  # nothing where everything is known
    return (diffused[..., :channels] + floor * mean) / (reached + floor)


@jax.jit
def shadow_pass(
    raw: Float[Array, "h w c"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w c"]:
    """Refine visibility by few steps at high resolution, which softens shadows and keeps their shape.

    The same diffusion as for the shading: the guide keeps a shadow from leaking onto the next object.

    Args:
        raw: visibility, in [0, 1].
        guide: as for `cascade`.
        schedule: few steps at factor 1 or 2, such as `Schedule.preset("shadow")`.
    """
    return cascade(raw, guide, schedule)


@jax.jit
def fill_visibility(
    raw: Float[Array, "h w l"], known: Bool[Array, "h w l"], guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w l"]:
    """Visibility where the mesh does not tell it, from the surroundings, by the coarse levels of a schedule.

    Nothing is known in holes, nor of a light on surfaces turned away from it. What lies there in truth may well be
    lit or shadowed as its neighbours are, and must not bring light (or darkness) of its own into the picture.

    Args:
        raw: visibility, a channel for each light.
        known: where it means anything.
        guide: as for `cascade`.
        schedule: as for the shading; its finest level is left out, since only the coarse ones reach across holes.
    """
    coarse = dataclasses.replace(schedule, levels=schedule.levels[:-1] or schedule.levels)
    return jnp.where(known, raw, cascade_known(raw, known, guide, coarse))
