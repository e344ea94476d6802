"""One frame, whole: a view, the light on it, a guide and a schedule → the relit picture.

Order, as in the paper: the shading without shadows is repaired by the cascade, the visibility is refined in a pass
of its own, the two are multiplied, and then multiplied with the frame. Diffusion is linear and every light has one
colour, so in mode `linear` each light is a single channel of both passes: shading and shadow of one light never mix
with those of another, and a sun that is mostly shadowed leaves no trace in what the sky lights.

Missing surface and missing light are never confused: a hole has no shading and no visibility of its own, and takes
both on from its surroundings; so does the visibility of a light on surfaces turned away from it, which may in truth
well be lit or shadowed as their neighbours are.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.core.cascade import cascade
from hyjax.core.pyramid import level_shape
from hyjax.core.refine import cascade_known, fill_visibility, shadow_pass
from hyjax.core.schedule import Schedule
from hyjax.light.color import encoded
from hyjax.light.light_edges import Weights, edge_correction, own_light, sharpened
from hyjax.light.relit import Relit, compared, composite_display, filter_and_light, ratio, relit_picture
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.light.view import View
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.tracing import Run, call, concrete

Mode = Literal["linear", "paper"]
TemporalFilter = Callable[
    [Float[Array, "h w c"], Float[Array, "h w l"]], tuple[Float[Array, "h w c"], Float[Array, "h w l"]]
]


@checked_arguments
def relight(
    view: View,
    shaded: Shaded,
    guide: Float[Array, "h w f"],
    schedule: Schedule | str,
    *,
    shadow_schedule: Schedule | str | None = None,
    temporal_filter: TemporalFilter | None = None,
    mode: Mode = "linear",
    light_edges: Weights | None = None,
) -> Relit:
    """Relit picture of one view.

    Args:
        view: the camera's picture with the surface that it shows. If it has a full picture, the filter is brought
            to that size, see `hyjax.light.relit`; not in mode `"paper"`.
        shaded: light on that surface, see `View.shade`.
        guide: features that say where light may flow; `view.display` is the "RGB guide".
        schedule: cascade for the shading, or a preset's name.
        shadow_schedule: cascade for the visibility, likewise; default the preset `hyjax-scan-shadow`, in mode
            `"paper"` `shadow`.
        temporal_filter: function of the refined illuminance and visibility of each light that returns what to take
            instead. See `hyjax.video`; not in mode `"paper"`.
        mode: `"linear"` multiplies linear light and treats pixels without surface as unknown; `"paper"` clips and
            display-encodes the filter, leaves holes black, trusts all else, and multiplies display values.
        light_edges: weights of the network that sharpens the photo's own light, where `shaded` has it, see
            `hyjax.light.light_edges`; `from hyjax.guide.edge_weights import edge_weights` has those that come with
            hyjax, `edge_weights()`. None to leave it as it is. Not in mode `"paper"`.

    Returns:
        All stages; `image` and `unrefined` are linear in both modes. Pixels of the frame that are not finite are
        black, and nothing flows through cells of the guide that are not finite: neither affects the rest of the
        picture but for the nearest cells.

    Raises:
        InputError: sizes differ, unknown mode, a schedule that cannot be run, or weights of another network.

    Warns:
        UserWarning: nothing of the frame is known. The relit frame is then what the ambient lights make of it; the
            frame itself if there are none (in mode `"paper"`: black).

    Example:
        scene = hyjax.Scene.open(hyjax.SceneSettings(size="320x240"))
        view = scene.view(0)
        relit = hyjax.relight(view, scene.shade(view, "golden-hour"), view.display, hyjax.Schedule.preset("hyjax"))
    """
    *_, (_, relit) = relight_stages(
        view,
        shaded,
        guide,
        schedule,
        shadow_schedule=shadow_schedule,
        temporal_filter=temporal_filter,
        mode=mode,
        light_edges=light_edges,
    )
    return relit


@checked_arguments
def relight_stages(
    view: View,
    shaded: Shaded,
    guide: Float[Array, "h w f"],
    schedule: Schedule | str,
    *,
    shadow_schedule: Schedule | str | None = None,
    temporal_filter: TemporalFilter | None = None,
    mode: Mode = "linear",
    light_edges: Weights | None = None,
    run: Run = call,
) -> Iterator[tuple[str, Any]]:
    """`relight` stage by stage: each stage's name with its result.

    "composite" comes with the picture, linear, and last "comparison" with all of `Relit`: whoever wants the picture
    alone need not ask for that.

    To time, look at or stop between the stages. Arguments and errors are those of `relight`; `run` runs the
    functions of the stages.
    """
    schedule = Schedule.of(schedule)
    if shadow_schedule is None:
        shadow_schedule = default_shadow_schedule(mode)
    shadow_schedule = Schedule.of(shadow_schedule, where="shadow_schedule")
    if light_edges is not None and mode == "paper":
        raise InputError("relight: mode 'paper' keeps the photo's own light; leave light_edges out")
    if temporal_filter is not None and mode == "paper":
        raise InputError("relight: temporal_filter works on channels of lights, which mode 'paper' does not have")
    if mode == "paper" and (shaded.surface_fields or shaded.emission is not None):
        raise InputError("relight: mode 'paper' keeps the photo's own light; shade with keep_photo_light=True")
    size, hit, lit = view.frame.shape[:2], view.gbuffer.hit.shape, shaded.illuminance.shape
    if not size == hit == guide.shape[:2] == lit[:2]:
        raise InputError(
            f"relight: frame {size}, G-buffer {hit}, shading {lit[:2]} and guide {guide.shape[:2]} must be of one "
            "size"
        )
    if (
        shaded.visibility.shape != lit
        or shaded.colors.shape != (lit[2], 3)
        or shaded.confidence.shape != (*size, 1)
    ):
        raise InputError(
            f"relight: visibility {shaded.visibility.shape}, colours {shaded.colors.shape} and confidence "
            f"{shaded.confidence.shape} do not fit the illuminance {lit}"
        )
    drawn = size if view.full is None else level_shape((view.full.shape[0], view.full.shape[1]), view.source_factor)
    if shaded.emission is not None and shaded.emission.weight.shape[:2] != drawn:
        raise InputError(
            f"relight: emission {shaded.emission.weight.shape[:2]} must be of {drawn}, as sources are drawn"
        )
    for used in (schedule, shadow_schedule):
        used.check(dtype=shaded.illuminance.dtype)
    known = concrete(view.gbuffer.hit if mode == "paper" else shaded.confidence)
    if known is not None and not (np.asarray(known) > 0).any():
        left = "the relit frame is black" if mode == "paper" else "only ambient light is used"
        if shaded.emission is not None:  # nor is the light of the photo on frames of windows
            dark = jnp.zeros_like(shaded.emission.frame_light)
            shaded = dataclasses.replace(shaded, emission=dataclasses.replace(shaded.emission, frame_light=dark))
        warnings.warn(f"relight: nothing of the frame is known; {left}", stacklevel=3)
    if mode == "paper":
        if view.factor > 1:
            raise InputError("relight: mode 'paper' works at full size; take a view without a full picture")
        yield from _paper_stages(view, shaded, guide, schedule, shadow_schedule, run)
        return
    cascade_call, shadow_call = cascade_calls(shaded, guide, schedule, shadow_schedule)
    illuminance = run(*cascade_call)
    yield "cascade", illuminance
    visibility = run(*shadow_call)
    yield "shadow pass", visibility
    correction = None
    if light_edges is not None and shaded.photo_light is not None and shaded.refined_photo_light is None:
        correction = run(edge_correction, view, run(own_light, illuminance), light_edges)
        yield "light edges", correction
    if temporal_filter is not None:
        if correction is not None:
            illuminance, correction = run(sharpened, illuminance, correction), None
        illuminance, visibility = temporal_filter(illuminance, visibility)
        yield "temporal filter", (illuminance, visibility)
    refined, kappa = (illuminance, visibility), schedule.levels[-1].kappa
    interpolation = {"norm": schedule.norm, "upsampling": schedule.upsampling}
    filter_and_lux = run(filter_and_light, _surface_alone(shaded), *refined, correction)
    yield "relight filter", filter_and_lux[0]
    image = run(relit_picture, view, *filter_and_lux, shaded.emission, kappa, **interpolation)
    yield "composite", image
    yield "comparison", run(compared, view, shaded, *refined, image, kappa, correction, **interpolation)


def cascade_calls(
    shaded: Shaded, guide: Float[Array, "h w f"], schedule: Schedule, shadow_schedule: Schedule
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Functions of the two cascades in mode `linear` with their arguments, the largest programs of a frame."""
    return (
        (refine_illuminance, _surface_alone(shaded), guide, schedule),
        (refine_visibility, _lights_alone(shaded), guide, shadow_schedule),
    )


def _surface_alone(shaded: Shaded) -> Shaded:
    """Light without emission: frames with and without emitting pixels share a program."""
    return dataclasses.replace(shaded, emission=None)


def _lights_alone(shaded: Shaded) -> Shaded:
    """Light of the lights alone, whose visibility is refined."""
    return dataclasses.replace(shaded, bounced=None, photo_light=None, emission=None, refined_photo_light=None)


def default_shadow_schedule(mode: Mode) -> Schedule:
    """Cascade for the visibility of a scan where none is given."""
    return Schedule.preset("shadow" if mode == "paper" else "hyjax-scan-shadow")


def refine_illuminance(shaded: Shaded, guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w c"]:
    """Illuminance of each light after the cascade: holes filled, borders moved to the guide's.

    After the lights come the channels of `Shaded.surface_fields`, refined alike: what is divided by each other must
    be wrong at the same places. A photo's light that was refined before is left out.
    """
    fields = shaded.surface_fields if shaded.refined_photo_light is None else shaded.surface_fields[:-1]
    channels = _joined(shaded.illuminance, *fields) if fields else shaded.illuminance
    return cascade_known(channels, shaded.confidence, guide, schedule)


def refine_visibility(shaded: Shaded, guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w l"]:
    """Visibility of each light after the shadow pass, filled where the mesh or the light leaves it unknown."""
    known = _lit(shaded.illuminance, shaded.confidence)
    filled = fill_visibility(shaded.visibility, known, guide)
    return shadow_pass(filled, guide, schedule)


@jax.jit
def _joined(*channels: Float[Array, "h w _"]) -> Float[Array, "h w _"]:
    return jnp.concatenate(channels, axis=-1)


@jax.jit
def _lit(illuminance: Float[Array, "h w l"], confidence: Float[Array, "h w 1"]) -> Bool[Array, "h w l"]:
    return (illuminance > 0) & (confidence > 0)


def _paper_stages(
    view: View,
    shaded: Shaded,
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    shadow_schedule: Schedule,
    run: Run,
) -> Iterator[tuple[str, Any]]:
    """The paper: the filter is a rendered picture, clipped and display-encoded, black where there is no mesh."""
    raw = run(_rendered, shaded.illuminance, shaded.colors, shaded.reference_lux)
    raw_shadowed = run(_rendered, shaded.illuminance * shaded.visibility, shaded.colors, shaded.reference_lux)
    refined = run(cascade, raw, guide, schedule)
    yield "cascade", refined
    visible = run(shadow_pass, run(ratio, raw_shadowed, raw), guide, shadow_schedule)
    yield "shadow pass", visible
    relit = run(composite_display, view.frame, raw, raw_shadowed, refined, visible)
    yield "composite", relit.image
    yield "comparison", relit


@jax.jit
def _rendered(
    illuminance: Float[Array, "h w l"], colors: Float[Array, "l 3"], reference_lux: Float[ArrayLike, ""]
) -> Float[Array, "h w 3"]:
    return encoded(mix_channels(illuminance, colors) / reference_lux)
