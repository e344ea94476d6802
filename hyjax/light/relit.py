"""Relit picture: the frame times its refined filter (Eq. 1), and the stages for comparison."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.finite import finite_or_zero
from hyjax.core.pyramid import downsample, upsample
from hyjax.core.schedule import Norm, Upsampling
from hyjax.core.upsampling import guided_upsample, upsample_planes
from hyjax.light.color import to_display, to_linear
from hyjax.light.compositing import composite
from hyjax.light.emission import Emission
from hyjax.light.light_edges import sharpened
from hyjax.light.photo_light import LEAST_PHOTO_LIGHT
from hyjax.light.shaded import Shaded
from hyjax.light.shading import mix_channels
from hyjax.light.view import View


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Relit:
    """Stages of a relit frame. Filters are linear in mode `linear`, display-encoded in mode `paper`.

    Attributes:
        shading: raw relight filter R without shadows; zero where the mesh has no surface.
        refined: the filter after the cascade, without shadows.
        visibility: share that the refined shadows leave of it, in [0, 1].
        relight_filter: refined filter with refined shadows, the factor of the frame.
        unrefined: the frame times the raw filter with its raw shadows, to compare with; linear.
        image: the relit frame; linear: `hyjax.to_display` shows 1.2 as white.
    """

    shading: Float[Array, "h w 3"]
    refined: Float[Array, "h w 3"]
    visibility: Float[Array, "h w 3"]
    relight_filter: Float[Array, "h w 3"]
    unrefined: Float[Array, "h w 3"]
    image: Float[Array, "h w 3"]


@jax.jit
def filter_and_light(
    shaded: Shaded,
    illuminance: Float[Array, "h w c"],
    visibility: Float[Array, "h w l"],
    correction: Float[Array, "h w 1"] | None = None,
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"]]:
    """Relight filter, and the new light over the reference.

    Args:
        illuminance, visibility: refined.
        correction: of the photo's own light, see `hyjax.light.light_edges.edge_correction`.
    """
    direct, fields = _split(illuminance, shaded, correction)
    return _filter_and_light(direct * visibility, fields, shaded)


@functools.partial(jax.jit, static_argnames=("norm", "upsampling"))
def relit_picture(
    view: View,
    relight_filter: Float[Array, "h w 3"],
    light: Float[Array, "h w 3"],
    emission: Emission | None,
    kappa: Float[ArrayLike, ""],
    *,
    norm: Norm = "l2",
    upsampling: Upsampling = "guide",
) -> Float[Array, "fh fw 3"]:
    """Relit picture (Eq. 1), linear. Pixels of the frame that are not finite are black.

    Where the view has a full picture, filter and light are interpolated under it, as a cascade's last level is, and
    the picture is multiplied at full size: its texture stays.

    Args:
        relight_filter, light: of `filter_and_light`.
        emission: at the size at which sources are drawn, see `View.source_factor`.
        kappa, norm, upsampling: of the interpolation, see `Schedule`.

    Source: Kopf, Cohen, Lischinski and Uyttendaele, *Joint bilateral upsampling*, SIGGRAPH 2007.
    """
    whole = functools.partial(_upscaled, view, kappa, norm, upsampling)
    if emission is None:
        return composite(_pixels(whole(_planes(relight_filter))), finite_or_zero(view.whole_frame()))
    if view.source_factor > 1:
        return _in_two_steps(view, relight_filter, light, emission, kappa, norm, upsampling)
    planes = _planes(relight_filter), _planes(light), jax.tree.map(_planes, emission)
    return _pixels(_with_sources(view, *planes, whole)[1])


def _with_sources(
    view: View,
    relight_filter: Float[Array, "3 h w"],
    light: Float[Array, "3 h w"],
    emission: Emission,
    whole: Callable[[Array], Array],
) -> tuple[Float[Array, "3 fh fw"], Float[Array, "3 fh fw"]]:
    """Relight filter and relit picture with what emits, all with channels first."""
    relight_filter, light = jnp.split(whole(jnp.concatenate([relight_filter, light])), 2)
    relight_filter = _framed(relight_filter, light, emission)
    picture = relight_filter * _planes(finite_or_zero(view.whole_frame()))  # as `composite`
    return relight_filter, _with_emission(picture, light, emission)


def _in_two_steps(
    view: View,
    relight_filter: Float[Array, "h w 3"],
    light: Float[Array, "h w 3"],
    emission: Emission,
    kappa: Float[ArrayLike, ""],
    norm: Norm,
    upsampling: Upsampling,
) -> Float[Array, "fh fw 3"]:
    """`relit_picture` by way of the size at which sources are drawn: emission is brought up as it is."""
    assert view.full is not None
    factor, display = view.source_factor, downsample(view.full, view.source_factor)
    smaller = dataclasses.replace(view, full=display, full_frame=None, factor=view.factor // factor)
    whole = functools.partial(_upscaled, smaller, kappa, norm, upsampling)
    emission = jax.tree.map(_planes, emission)
    relight_filter, picture = _with_sources(smaller, _planes(relight_filter), _planes(light), emission, whole)
    shining = picture - (1.0 - emission.weight) * relight_filter * _planes(finite_or_zero(smaller.whole_frame()))
    # One by one: XLA on the CPU takes three times longer for all of them stacked, and then parted again.
    relight_filter, weight, shining = (
        guided_upsample(_pixels(x), factor, view.full, kappa, coarse=display)
        for x in (relight_filter, emission.weight, shining)
    )
    relit = composite(relight_filter, finite_or_zero(view.whole_frame()))
    return (1.0 - weight) * relit + shining


@functools.partial(jax.jit, static_argnames=("norm", "upsampling"))
def compared(
    view: View,
    shaded: Shaded,
    illuminance: Float[Array, "h w c"],
    visibility: Float[Array, "h w l"],
    image: Float[Array, "fh fw 3"],
    kappa: Float[ArrayLike, ""],
    correction: Float[Array, "h w 1"] | None = None,
    *,
    norm: Norm = "l2",
    upsampling: Upsampling = "guide",
) -> Relit:
    """Stages of a relit frame for comparison; arguments of both functions above, and the result of the second.

    Filters of a large picture with sources are brought to full size in one step, the picture's own in two.
    """
    emission = shaded.emission
    channels = shaded.illuminance, shaded.illuminance * shaded.visibility
    unrefined = [
        _divide(_light(light, shaded, shaded.surface_fields), shaded, shaded.surface_fields) for light in channels
    ]
    direct, fields = _split(illuminance, shaded, correction)
    refined = *_filter_and_light(direct, fields, shaded), *_filter_and_light(direct * visibility, fields, shaded)
    stages = *unrefined, *refined
    whole = functools.partial(_upscaled, view, kappa, norm, upsampling)
    raw, raw_shadowed, filtered, light, relight_filter, shadowed = (whole(_planes(stage)) for stage in stages)
    if emission is not None and view.source_factor > 1:
        emission = jax.tree.map(lambda x: upsample(x, view.source_factor, light.shape[1:]), emission)
    emission = jax.tree.map(_planes, emission)
    filtered, relight_filter = _framed(filtered, light, emission), _framed(relight_filter, shadowed, emission)
    picture = _with_emission(raw_shadowed * _planes(finite_or_zero(view.whole_frame())), shadowed, emission)
    raw, filtered, relight_filter, picture = map(_pixels, (raw, filtered, relight_filter, picture))
    return Relit(raw, filtered, ratio(relight_filter, filtered), relight_filter, picture, image)


def _planes(picture: Float[Array, "h w c"]) -> Float[Array, "c h w"]:
    """Picture with its channels first: XLA's CPU backend is slow where innermost ones meet a value of the pixel."""
    return jnp.moveaxis(picture, -1, 0)


def _pixels(planes: Float[Array, "c h w"]) -> Float[Array, "h w c"]:
    return jnp.moveaxis(planes, 0, -1)


def _upscaled(
    view: View, kappa: Float[ArrayLike, ""], norm: Norm, upsampling: Upsampling, stage: Float[Array, "c h w"]
) -> Float[Array, "c fh fw"]:
    """Stage at the size of the full picture."""
    if view.full is None or view.factor == 1:
        return stage
    if upsampling == "bilinear":
        return _planes(upsample(_pixels(stage), view.factor, (view.full.shape[0], view.full.shape[1])))
    full, coarse = (_planes(finite_or_zero(picture)) for picture in (view.full, view.display))
    return upsample_planes(stage, view.factor, full, coarse, kappa, norm=norm)


def _filter_and_light(
    channels: Float[Array, "h w l"], fields: Sequence[Float[Array, "h w 3"]], shaded: Shaded
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"]]:
    """Relight filter and new light, or the ambient lights' where nothing of the frame is known."""
    light = _light(channels, shaded, fields)
    return _or_ambient(_divide(light, shaded, fields), shaded), _or_ambient(light, shaded)


def _split(
    illuminance: Float[Array, "h w c"], shaded: Shaded, correction: Float[Array, "h w 1"] | None
) -> tuple[Float[Array, "h w l"], list[Float[Array, "h w 3"]]]:
    """Split off the channels of the lights from fields of three channels each, with light edges."""
    illuminance = illuminance if correction is None else sharpened(illuminance, correction)
    count = shaded.illuminance.shape[-1]
    rest, before = illuminance[..., count:], shaded.refined_photo_light
    fields = jnp.split(rest, rest.shape[-1] // 3, axis=-1) if rest.shape[-1] else []
    return illuminance[..., :count], fields if before is None else [*fields, before]


def _or_ambient(relight_filter: Float[Array, "h w 3"], shaded: Shaded) -> Float[Array, "h w 3"]:
    """Filter, or the ambient lights' where nothing of the frame is known."""
    return jnp.where(jnp.any(shaded.confidence > 0), relight_filter, shaded.ambient)


def _framed(
    relight_filter: Float[Array, "3 h w"], light: Float[Array, "3 h w"], emission: Emission | None
) -> Float[Array, "3 h w"]:
    """Filter, smaller on frames of windows, which had more light in the photo than what is beside them."""
    if emission is None:
        return relight_filter
    return jnp.minimum(relight_filter, light / jnp.maximum(emission.frame_light, LEAST_PHOTO_LIGHT))


def _with_emission(
    picture: Float[Array, "3 h w"], light: Float[Array, "3 h w"], emission: Emission | None
) -> Float[Array, "3 h w"]:
    """Picture with its emitting pixels, which also reflect light."""
    if emission is None:
        return picture
    return picture + emission.weight * (emission.sent + emission.reflectance * light - picture)


def _light(
    channels: Float[Array, "h w l"], shaded: Shaded, fields: Sequence[Float[Array, "h w 3"]]
) -> Float[Array, "h w 3"]:
    """New light, direct and bounced, over the reference illuminance."""
    light = mix_channels(channels, shaded.colors)
    return (light if shaded.bounced is None else light + fields[0]) / shaded.reference_lux


def _divide(
    light: Float[Array, "h w 3"], shaded: Shaded, fields: Sequence[Float[Array, "h w 3"]]
) -> Float[Array, "h w 3"]:
    """Relight filter: new light over the light of the photo."""
    return light if shaded.photo_light is None else light / jnp.maximum(fields[-1], LEAST_PHOTO_LIGHT)


@jax.jit
def composite_display(
    frame: Float[Array, "h w 3"],
    raw: Float[Array, "h w 3"],
    raw_shadowed: Float[Array, "h w 3"],
    refined: Float[Array, "h w 3"],
    visible: Float[Array, "h w 3"],
) -> Relit:
    """Relit picture as the paper's product of display values.

    Args:
        frame: camera picture, linear.
        raw, raw_shadowed: filter before the refinement, without and with shadows; display-encoded like all filters.
        visible: share that the refined shadows leave of it.
    """
    display, relight_filter = to_display(finite_or_zero(frame)), refined * visible
    unrefined, image = (to_linear(composite(f, display)) for f in (raw_shadowed, relight_filter))
    return Relit(raw, refined, visible, relight_filter, unrefined, image)


@jax.jit
def ratio(part: Float[Array, "h w 3"], whole: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """Share of `part` in `whole`, in [0, 1]; 1 where the whole is nothing."""
    return jnp.where(whole > 0, part / jnp.where(whole > 0, whole, 1.0), 1.0)
