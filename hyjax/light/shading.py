"""Lambert shading of the visible surface: the raw relight filter R of Eq. 1, without shadows."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import Light
from hyjax.light.setup import check_lights
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError


@checked_arguments
def shade(gbuffer: GBuffer, lights: Sequence[Light]) -> Float[Array, "h w 3"]:
    """Illuminance of every visible surface point by all lights together, without shadows.

    A diffuse surface of any albedo reflects light in proportion to its illuminance, so the ratio of this to the
    illuminance under which the frame was taken is the filter that relights the frame.

    Args:
        gbuffer: what the camera sees of the mesh.
        lights: any mixture of kinds, at least one.

    Returns:
        Lux for red, green and blue; zero where the camera's ray missed the mesh.

    Raises:
        InputError: no lights.
    """
    check_lights(lights)
    return colored(shade_each(gbuffer, lights), lights)


@checked_arguments
@jax.jit
def shade_each(gbuffer: GBuffer, lights: Sequence[Light]) -> Float[Array, "h w l"]:
    """Illuminance by each light alone, before its colour; see `shade`.

    Returns:
        Lux, a channel for each light; zero where the camera's ray missed the mesh.

    Raises:
        InputError: no lights.
    """
    check_lights(lights)
    illuminance = [_illuminance(light, gbuffer.position, gbuffer.normal) for light in lights]
    return jnp.where(gbuffer.hit[..., None], jnp.stack(illuminance, axis=-1), 0.0)


@jax.jit
def _illuminance(light: Light, position: Float[Array, "*s 3"], normal: Float[Array, "*s 3"]) -> Float[Array, "*s"]:
    """Illuminance by a light; a function of its own is traced once for all lights of a kind."""
    return light.illuminance_at(position, normal)


@checked_arguments
@jax.jit
def colored(each: Float[Array, "h w l"], lights: Sequence[Light]) -> Float[Array, "h w 3"]:
    """Sum of one channel for each light, times the lights' colours.

    Raises:
        InputError: another number of lights than channels.
    """
    if each.shape[-1] != len(lights):
        raise InputError(f"lights: {len(lights)} for {each.shape[-1]} channels; give one for each")
    return mix_channels(each, [light.color for light in lights])


def mix_channels(
    channels: Float[Array, "h w l"], colors: Float[Array, "l 3"] | Sequence[Float[Array, "3"]]
) -> Float[Array, "h w 3"]:
    """Sum of one channel for each light, times their colours.

    Added one by one: XLA's CPU backend takes longer to reduce an axis.
    """
    return functools.reduce(jnp.add, [channels[..., k, None] * colors[k] for k in range(channels.shape[-1])])
