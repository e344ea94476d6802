"""Lambert shading of what the camera sees: the raw relight filter R of Eq. 1, without shadows."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.errors import InputError
from hyjax.gbuffer import GBuffer
from hyjax.lights import Light


def shade(gbuffer: GBuffer, lights: Sequence[Light]) -> Float[Array, "h w 3"]:
    """Illuminance on every visible surface point from all lights together, nothing in the way.

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
    if not lights:
        raise InputError("shade: no lights; give at least one")
    return _total(shade_each(gbuffer, lights))


@jax.jit
def shade_each(gbuffer: GBuffer, lights: Sequence[Light]) -> tuple[Float[Array, "h w 3"], ...]:
    """As `shade`, each light by itself."""
    each = (light.irradiance(gbuffer.position, gbuffer.normal) for light in lights)
    return tuple(jnp.where(gbuffer.hit[..., None], lux, 0.0) for lux in each)


@jax.jit
def _total(each: tuple[Float[Array, "h w 3"], ...]) -> Float[Array, "h w 3"]:
    # Added one by one: XLA's CPU backend takes many times as long to reduce a stack.
    return functools.reduce(jnp.add, each)
