"""From the light that falls on a frame to the picture that a view of it shows."""

import dataclasses
import functools
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, UInt8

from hyjax.color import blackbody, to_display
from hyjax.data.capture import Frame
from hyjax.diffusion import conductance
from hyjax.gbuffer import GBuffer
from hyjax.lights import PointLight
from hyjax.pipeline import Relit, relight_stages
from hyjax.schedule import Level, Schedule
from hyjax.tuning.latency import StageClock

Shown = Literal["relit", "photo", "raw filter", "refined filter", "visibility", "conductances", "holes"]

CHANNELS = 4
"""Lights are rounded up to a multiple of this: a lamp more rarely means compiling anew."""
AMOUNTS = ("power", "illuminance")


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """What somebody looks at: a frame of the capture, a stage of its picture, and how the light is refined."""

    frame: int
    shown: Shown
    schedule: Schedule


@dataclasses.dataclass(frozen=True)
class Painting:
    """A view, painted.

    Attributes:
        picture: display-encoded, what the view shows.
        photo: display-encoded, the frame as it was taken.
        linear: the relit picture in linear light.
        frame: whose it is.
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
class Seen:
    """A frame on the device."""

    linear: Float[Array, "h w 3"]
    guide: Float[Array, "h w f"]


def relight_layers(
    clock: StageClock,
    entries: list[dict[str, Any]],
    reference_lux: float,
    layers: list[tuple[Array, Array]],
    seen: Seen,
    gbuffer: GBuffer,
    schedule: Schedule,
) -> Relit:
    """Relight a frame with what each light throws on it.

    Args:
        clock: times the stages.
        entries: of the lights file; their brightness and colour.
        reference_lux: the light that the camera exposes for.
        layers: of each light lux for an amount of 1, and visibility.
        seen, gbuffer: the frame, and the surface in it.
        schedule: of the diffusion.
    """
    count = -(-len(entries) // CHANNELS) * CHANNELS
    amounts = np.zeros(count, np.float32)
    colors = np.ones((count, 3), np.float32)
    for k, entry in enumerate(entries):
        amounts[k], colors[k] = entry[amount_key(entry)], _color(round(entry["temperature"], 0))
    lux, lit = layers[0]
    dark = jnp.zeros_like(lux), jnp.ones_like(lit)
    each, visible = _stack((*layers, *[dark] * (count - len(layers))), amounts)
    # All that is left of a light once it has been shaded is its colour.
    nowhere, nothing = jnp.zeros(3), jnp.zeros(())
    lights = [PointLight(nowhere, nothing, color) for color in colors]  # type: ignore[arg-type]
    stages = relight_stages(
        seen.linear,
        gbuffer,
        lights,
        seen.guide,
        schedule,
        shading=each,
        visibility=visible,
        reference_lux=np.float32(reference_lux),
    )
    return clock.follow(stages)


@jax.jit
def _stack(layers: tuple[tuple[Array, Array], ...], amounts: Array) -> tuple[Array, Array]:
    each = jnp.stack([lux for lux, _ in layers], axis=-1) * amounts
    return each, jnp.stack([lit for _, lit in layers], axis=-1)


def shown_in(view: View, relit: Relit, seen: Seen, gbuffer: GBuffer) -> Array:
    """What a view shows, display-encoded, (h, w, 3)."""
    if view.shown == "photo":
        return to_display(seen.linear)
    if view.shown == "raw filter":
        # With its shadows, as an unrefined renderer shows it.
        return to_display(relit.unrefined / jnp.maximum(seen.linear, 1e-3))
    if view.shown == "refined filter":
        return to_display(relit.relight_filter)
    if view.shown == "visibility":
        return relit.visibility
    if view.shown == "conductances":
        kappa = view.schedule.levels[-1].kappa
        vertical, horizontal = conductance(seen.guide, kappa, norm=view.schedule.norm)
        grey = jnp.minimum(
            jnp.pad(vertical, ((0, 1), (0, 0)), constant_values=1.0),
            jnp.pad(horizontal, ((0, 0), (0, 1)), constant_values=1.0),
        )
        return jnp.broadcast_to(grey[..., None], (*grey.shape, 3))
    if view.shown == "holes":
        magenta = jnp.array([1.0, 0.0, 0.7])
        return jnp.where(gbuffer.hit[..., None], 0.6 * to_display(seen.linear), magenta)
    return to_display(relit.image)


def amount_key(entry: dict[str, Any]) -> str:
    """Which key of a lights file's entry says how bright the light is."""
    return next(key for key in AMOUNTS if key in entry)


@functools.lru_cache(maxsize=4096)
def _color(kelvin: float) -> np.ndarray:
    return np.asarray(blackbody(kelvin), np.float32)


@jax.jit
def _quantised(picture: Array) -> Array:
    return jnp.round(jnp.clip(picture, 0.0, 1.0) * 255.0).astype(jnp.uint8)


def bytes_of(picture: Float[ArrayLike, "*s 3"]) -> UInt8[np.ndarray, "*s 3"]:
    """A display-encoded picture in whole numbers."""
    return np.asarray(_quantised(picture))


def more_steps(step_sizes: Float[np.ndarray, "n"], times: float) -> Float[np.ndarray, "m"]:
    """Step sizes for so many times the steps; cycles of varying sizes are repeated whole, as they must be."""
    if len(set(step_sizes.tolist())) > 1:
        return np.tile(step_sizes, max(round(times), int(times > 0)))
    return np.resize(step_sizes, round(len(step_sizes) * times)) if len(step_sizes) else step_sizes


def adjusted(schedule: Schedule, steps: float, kappa: float) -> Schedule:
    """A schedule of so many times the steps and so many times the κ."""

    def level(old: Level) -> Level:
        step_sizes = more_steps(np.asarray(old.step_sizes), steps)
        return Level(old.factor, step_sizes, np.float32(np.asarray(old.kappa) * kappa), old.attachment)

    levels = tuple(level(old) for old in schedule.levels)
    return Schedule(levels, schedule.pooling, schedule.norm, schedule.name, schedule.upsampling)
