"""Pictures of a tour: a stage of the relit frame as bytes."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Shaped, UInt8

from hyjax.core.diffusion import conductance
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.light.color import encoded, luminance, to_display_bytes, to_linear
from hyjax.light.gbuffer import GBuffer
from hyjax.light.relit import Relit
from hyjax.light.shaded import Shaded
from hyjax.scene.relighter import LitFrame
from hyjax.tour.viewpoint import Shown
from hyjax.util.images import to_bytes


class Reach(NamedTuple):
    """Share of a lamp in the light of a picture without shadows, and the share of it that shadows leave."""

    share: float
    visible: float


@dataclasses.dataclass(frozen=True)
class RenderedFrame:
    """Picture from a viewpoint.

    Attributes:
        picture: display-encoded, the stage that is shown.
        linear: the relit picture in linear light.
        milliseconds: by stage.
        draft: whether it is at a part of the frame's size, or with coarse shadows, and a finer one is to come.
        unseen: whether some is grey that moved furniture has uncovered, as no photo shows it.
        reach: of each lamp of the plan; None for those that give no light.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    linear: Float[np.ndarray, "h w 3"]
    frame: Frame
    milliseconds: dict[str, float]
    draft: bool
    unseen: bool = False
    reach: tuple[Reach | None, ...] = ()


COMPARED_STAGES: tuple[Shown, ...] = ("raw filter", "refined filter", "visibility")
"""Stages for which the unrefined light is needed, too."""


def shown_stage(
    shown: Shown, frame: Frame, lit: LitFrame, result: Relit | Float[Array, "h w 3"], schedule: Schedule
) -> UInt8[np.ndarray, "h w 3"]:
    """The stage that is shown.

    Args:
        result: after it; the picture alone will do for what is not among `COMPARED_STAGES`.
    """
    if isinstance(result, Relit):
        if shown == "raw filter":  # with its shadows, as an unrefined renderer shows it
            return to_bytes(_over(result.unrefined, frame.image))
        if shown == "visibility":
            return to_bytes(np.asarray(result.visibility))
        return to_bytes(np.asarray(jax.jit(encoded)(result.relight_filter)))
    if shown == "relit":
        return np.asarray(to_display_bytes(result))
    if shown == "conductances":
        picture = _conductances(lit.features, schedule)
    elif shown == "holes":
        picture = _holes(lit)
    else:
        picture = surface_stage(shown, lit.view.gbuffer)
    return to_bytes(np.asarray(enlarged(picture, frame.image.shape)))


def enlarged(picture: Shaped[ArrayLike, "h w c"], shape: tuple[int, ...]) -> Shaped[Array, "fh fw c"]:
    """Picture of a view at a part of a frame's size, each pixel repeated to the frame's height and width."""
    times = max(-(-size // cells) for size, cells in zip(shape[:2], np.shape(picture)[:2], strict=True))
    large = jnp.repeat(jnp.repeat(picture, times, axis=0), times, axis=1)
    return large[: shape[0], : shape[1]]


def surface_stage(shown: Shown, seen: GBuffer) -> Float[Array, "h w 3"]:
    """Normals or depth, as exported pages show them."""
    normals = 0.5 + 0.5 * seen.normal
    depth = jnp.broadcast_to(jnp.exp(-0.3 * seen.depth)[..., None], normals.shape)
    return jnp.where(seen.hit[..., None], normals if shown == "normals" else depth, 0.0)


@jax.jit
def reach_of(shaded: Shaded) -> Float[Array, "2 l"]:
    """`Reach` of each light."""
    lux = jnp.sum(shaded.illuminance, axis=(0, 1))
    visible = jnp.sum(shaded.illuminance * shaded.visibility, axis=(0, 1)) / jnp.maximum(lux, 1e-9)
    own = lux * luminance(shaded.colors)
    indirect = 0.0 if shaded.bounced is None else jnp.sum(luminance(shaded.bounced))
    return jnp.stack([own / jnp.maximum(jnp.sum(own) + indirect, 1e-9), visible])


@jax.jit
def _over(picture: Float[Array, "h w 3"], display: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    return encoded(picture / jnp.maximum(to_linear(display), 1e-3))


@jax.jit
def _conductances(guide: Float[Array, "h w f"], schedule: Schedule) -> Float[Array, "h w 3"]:
    vertical, horizontal = conductance(guide, schedule.levels[-1].kappa, norm=schedule.norm)
    grey = jnp.minimum(
        jnp.pad(vertical, ((0, 1), (0, 0)), constant_values=1.0),
        jnp.pad(horizontal, ((0, 0), (0, 1)), constant_values=1.0),
    )
    return jnp.broadcast_to(grey[..., None], (*grey.shape, 3))


@jax.jit
def _holes(lit: LitFrame) -> Float[Array, "h w 3"]:
    return jnp.where(lit.view.gbuffer.hit[..., None], 0.6 * lit.view.display, jnp.array([1.0, 0.0, 0.7]))
