"""One frame, whole: G-buffer + lights + frame + guide + schedule → relit picture.

Order, as in the paper: shade the mesh without shadows, repair the shading by the cascade, refine the visibility in
a pass of its own, multiply the two, multiply with the frame.
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
from hyjax.shading import shade_each
from hyjax.shadow import ShadowMap, shadow_ratio, visibility

Mode = Literal["hyjax", "paper"]

# Illuminance under which the frame is taken to have been photographed: an ordinary room in daylight or lamplight.
REFERENCE_LUX = 300.0

# Weight below which a hole counts as too far from any surface to be filled from its surroundings.
HOLE_FLOOR = 1e-3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Relit:
    """What `relight` made of a frame, stage by stage. All linear in mode `hyjax`; see `relight` for `paper`.

    Attributes:
        shading: raw relight filter R without shadows; zero where the mesh has no surface.
        refined: the filter after the cascade.
        raw_visibility: shadows as the mesh throws them, in [0, 1].
        visibility: after the shadow pass.
        relight_filter: refined filter times visibility, what the frame is multiplied with.
        unrefined: the frame times the raw filter with its raw shadows, to compare with; linear.
        image: the relit frame; linear.
    """

    shading: Float[Array, "h w 3"]
    refined: Float[Array, "h w 3"]
    raw_visibility: Float[Array, "h w 3"]
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
            display-encodes the filter, leaves holes black, and multiplies display values. In `"paper"` the filter
            fields of the result are display-encoded.

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
    shading, backdrop = _filter_and_backdrop(each, frame, reference_lux, mode=mode)
    yield "shading", shading
    seen = [visibility(gbuffer, light, shadow_map) for light, shadow_map in zip(lights, maps, strict=True)]
    raw_visibility = shadow_ratio(each, seen)
    yield "visibility", raw_visibility
    known = gbuffer.hit if mode == "hyjax" else None
    refined = cascade_known(shading, known, guide, schedule)
    yield "cascade", refined
    refined_visibility = shadow_pass(raw_visibility, known, guide, shadow_schedule, schedule)
    yield "shadow pass", refined_visibility
    relit = _finish(shading, refined, raw_visibility, refined_visibility, backdrop, mode=mode)
    yield "composite", relit


@functools.partial(jax.jit, static_argnames="mode")
def _filter_and_backdrop(
    each: tuple[Float[Array, "h w 3"], ...],
    frame: Float[Array, "h w 3"],
    reference_lux: Float[ArrayLike, ""],
    mode: Mode,
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"]]:
    """The raw filter R and what it will multiply, both linear or (paper) both display-encoded."""
    shading = functools.reduce(jnp.add, each) / reference_lux
    return (shading, frame) if mode == "hyjax" else (to_display(shading), to_display(frame))


@functools.partial(jax.jit, static_argnames="mode")
def _finish(
    shading: Float[Array, "h w 3"],
    refined: Float[Array, "h w 3"],
    raw_visibility: Float[Array, "h w 3"],
    refined_visibility: Float[Array, "h w 3"],
    backdrop: Float[Array, "h w 3"],
    mode: Mode,
) -> Relit:
    relight_filter = refined * refined_visibility
    image = composite(relight_filter, backdrop)
    unrefined = composite(shading * raw_visibility, backdrop)
    if mode == "paper":
        image, unrefined = to_linear(image), to_linear(unrefined)
    return Relit(shading, refined, raw_visibility, refined_visibility, relight_filter, unrefined, image)


@jax.jit
def cascade_known(
    y: Float[Array, "h w c"], known: Bool[Array, "h w"] | None, guide: Float[Array, "h w f"], schedule: Schedule
) -> Float[Array, "h w c"]:
    """`cascade` that treats pixels outside `known` as missing instead of taking their value for real.

    Diffuses (w y, w) with w = 1 on known pixels and divides, so that a hole takes on its surroundings' value
    instead of darkening them. Where no known pixel is within reach the mean of all known pixels stands in.

    Args:
        y: the filter to repair.
        known: where its values mean anything; None for everywhere, which is `cascade` itself.
        guide: see `cascade`.
        schedule: see `cascade`.

    Source: Knutsson and Westin, *Normalized and differential convolution*, CVPR 1993.
    """
    if known is None:
        return cascade(y, guide, schedule)
    weight = known[..., None].astype(y.dtype)
    weighted = jnp.concatenate([y * weight, weight], axis=-1)
    total = jnp.sum(downsample(weighted, schedule.levels[0].factor), axis=(0, 1))
    mean = total[:-1] / jnp.maximum(total[-1], TINY)
    diffused = cascade(weighted, guide, schedule)
    return (diffused[..., :-1] + HOLE_FLOOR * mean) / (diffused[..., -1:] + HOLE_FLOOR)


@jax.jit
def shadow_pass(
    raw: Float[Array, "h w c"],
    known: Bool[Array, "h w"] | None,
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    fill_schedule: Schedule,
) -> Float[Array, "h w c"]:
    """Refine visibility by few steps at high resolution, which softens shadows and keeps their shape.

    The same diffusion as for the shading: the guide keeps a shadow from leaking onto the next object. Pixels
    outside `known` are first filled from their surroundings by the coarse levels of `fill_schedule`, which reach
    across holes.

    Args:
        raw: visibility from shadow maps, in [0, 1].
        known: where the mesh has a surface; None takes `raw` as it is.
        guide: as for `cascade`.
        schedule: few steps at factor 1 or 2, such as `Schedule.preset("shadow")`.
        fill_schedule: the cascade that the shading is refined with; its finest level is left out.
    """
    if known is not None:
        coarse = dataclasses.replace(fill_schedule, levels=fill_schedule.levels[:-1] or fill_schedule.levels)
        raw = jnp.where(known[..., None], raw, cascade_known(raw, known, guide, coarse))
    return cascade(raw, guide, schedule)
