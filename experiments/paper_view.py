"""One frame of a bench at its working size, and operations on its filter."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import hyjax
from hyjax.core.schedule import Schedule
from hyjax.data.capture import Frame
from hyjax.geometry.camera import Camera
from hyjax.light.color import decoded, encoded
from hyjax.light.gbuffer import GBuffer
from hyjax.light.relit import Relit
from hyjax.pipeline import Mode


def linear_filter(relit: Relit, mode: Mode) -> Float[Array, "h w 3"]:
    """The refined filter, without shadows, as a factor of light."""
    return decoded(relit.refined) if mode == "paper" else relit.refined


def mean_colour(view: "View", relight_filter: Float[Array, "h w 3"], group: str) -> Float[Array, "h w 3"]:
    """One colour for the whole frame: the filter's mean, as the group has it, where the mesh has a surface."""
    known, display = view.rough.hit[..., None], group == "display values"
    averaged = encoded(relight_filter) if display else relight_filter
    mean = jnp.sum(averaged * known, axis=(0, 1)) / jnp.maximum(jnp.sum(known), 1)
    return jnp.broadcast_to(decoded(mean) if display else mean, relight_filter.shape)


def multiplied(view: "View", relight_filter: Float[Array, "h w 3"], group: str) -> Float[Array, "h w 3"]:
    """The frame times a linear filter, display values."""
    if group == "display values":
        return view.display * encoded(relight_filter)
    return hyjax.to_display(hyjax.to_linear(view.display) * relight_filter)


def with_kappa(schedule: Schedule, kappa: float) -> Schedule:
    """The schedule with one κ for all levels."""
    levels = tuple(dataclasses.replace(level, kappa=kappa) for level in schedule.levels)
    return dataclasses.replace(schedule, levels=levels)


@dataclasses.dataclass(frozen=True)
class View:
    """One frame, at the size that is worked at.

    Attributes:
        frame: as captured.
        display: its picture.
        guide: features of that.
        camera: of `display`.
        rough: what the camera sees of the rough surface.
        accurate: and of the accurate one.
        valid: where the accurate one is relied on.
        shading: lux on both from the lights of all set-ups, if Blender has rendered it.
    """

    frame: Frame
    display: Float[Array, "h w 3"]
    guide: Float[Array, "h w f"]
    camera: Camera
    rough: GBuffer
    accurate: GBuffer
    valid: Bool[np.ndarray, "h w"]
    shading: Sequence[Float[Array, "h w l"]] = ()

    @property
    def blind(self) -> bool:
        return not (bool(self.rough.hit.any()) and bool(self.valid.any()))
