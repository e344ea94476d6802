"""Pictures of a tour: light on a frame, and a stage of the relit frame as bytes."""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from hyjax.core.diffusion import conductance
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.light.color import to_display
from hyjax.light.relit import composite_linear
from hyjax.light.setup import LightSetup
from hyjax.light.shaded import Shaded
from hyjax.light.view import View
from hyjax.tour.viewpoint import Shown

CHANNELS = 2
"""Lights are rounded up to a multiple of this, so that another lamp seldom means compiling anew."""
Layer = tuple[Float[Array, "h w"], Float[Array, "h w"]]
"""Illuminance from one light in lux, and its visibility."""


@dataclasses.dataclass(frozen=True)
class RenderedFrame:
    """Picture from a viewpoint.

    Attributes:
        picture: display-encoded, the stage that is shown.
        photo: display-encoded, the frame as it was taken.
        linear: the relit picture in linear light.
        frame: the frame of the capture.
        milliseconds: by stage.
        draft: whether shadows are still coarse.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    photo: UInt8[np.ndarray, "h w 3"]
    linear: Float[np.ndarray, "h w 3"]
    frame: Frame
    milliseconds: dict[str, float]
    draft: bool


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class DeviceFrame:
    """A frame on the device: linear, display-encoded, and its guide."""

    linear: Float[Array, "h w 3"]
    display: Float[Array, "h w 3"]
    guide: Float[Array, "h w f"]


def stack_layers(
    setup: LightSetup, layers: Sequence[Layer], hit: Bool[Array, "h w"], *, sampling: int = 1
) -> Shaded:
    """Light on a frame, with channels of no light up to a multiple of `CHANNELS`.

    Args:
        setup: the lights.
        layers: of each light, if its strength were 1.
        hit: where there is a surface.
        sampling: see `Shaded`.
    """
    count = -(-len(layers) // CHANNELS) * CHANNELS
    strengths, colors = np.zeros(count, np.float32), np.ones((count, 3), np.float32)
    for k, light in enumerate(setup.lights):
        strengths[k], colors[k] = getattr(light, light.STRENGTH), light.color
    illuminance, visibility = layers[0]
    dark = jnp.zeros_like(illuminance), jnp.ones_like(visibility)
    padded = (*layers, *[dark] * (count - len(layers)))
    return _stack(padded, strengths, colors, hit, np.float32(setup.reference_lux), sampling=sampling)


@functools.partial(jax.jit, static_argnames="sampling")
def _stack(
    layers: tuple[Layer, ...],
    strengths: Float[Array, "l"],
    colors: Float[Array, "l 3"],
    hit: Bool[Array, "h w"],
    reference_lux: Float[Array, ""],
    *,
    sampling: int,
) -> Shaded:
    illuminance = jnp.stack([lux for lux, _ in layers], axis=-1) * strengths
    visibility = jnp.stack([visible for _, visible in layers], axis=-1)
    known = hit[..., None].astype(jnp.float32)
    return Shaded(illuminance, visibility, colors, known, reference_lux, jnp.ones(3), sampling=sampling)


@functools.partial(jax.jit, static_argnames="shown")
def compose(
    shown: Shown,
    view: View,
    shaded: Shaded,
    guide: Float[Array, "h w f"],
    schedule: Schedule,
    illuminance: Sequence[Float[Array, "h w c"]],
    visibility: Float[Array, "h w l"],
) -> tuple[UInt8[Array, "h w 3"], Float[Array, "h w 3"]]:
    """The stage that is shown as bytes, and the relit picture in linear light; no other stage is computed.

    Args:
        shown: static.
        view, shaded, visibility: see `hyjax.pipeline.composite_linear`.
        illuminance: channels of the lights and of `Shaded.surface_fields`, one after the other.
        guide, schedule: of the diffusion, whose conductances may be shown.
    """
    relit = composite_linear(view.frame, shaded, jnp.concatenate(illuminance, axis=-1), visibility)
    picture = to_display(relit.image)
    if shown == "photo":
        picture = to_display(view.frame)
    elif shown == "raw filter":
        # With its shadows, as an unrefined renderer shows it.
        picture = to_display(relit.unrefined / jnp.maximum(view.frame, 1e-3))
    elif shown == "refined filter":
        picture = to_display(relit.relight_filter)
    elif shown == "visibility":
        picture = relit.visibility
    elif shown == "conductances":
        picture = _conductances(guide, schedule)
    elif shown == "holes":
        magenta = jnp.array([1.0, 0.0, 0.7])
        picture = jnp.where(view.gbuffer.hit[..., None], 0.6 * to_display(view.frame), magenta)
    return _quantised(picture), relit.image


def _conductances(guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w 3"]:
    vertical, horizontal = conductance(guide, schedule.levels[-1].kappa, norm=schedule.norm)
    grey = jnp.minimum(
        jnp.pad(vertical, ((0, 1), (0, 0)), constant_values=1.0),
        jnp.pad(horizontal, ((0, 0), (0, 1)), constant_values=1.0),
    )
    return jnp.broadcast_to(grey[..., None], (*grey.shape, 3))


@jax.jit
def _quantised(picture: Array) -> Array:
    return jnp.round(jnp.clip(picture, 0.0, 1.0) * 255.0).astype(jnp.uint8)


def to_bytes(picture: Float[ArrayLike, "*s 3"]) -> UInt8[np.ndarray, "*s 3"]:
    """A display-encoded picture as bytes."""
    return np.asarray(_quantised(picture))
