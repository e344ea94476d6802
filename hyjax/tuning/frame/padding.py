"""Lit frames with as many lights as each other, so that one compiled program serves all."""

import dataclasses

import jax.numpy as jnp

from hyjax.light.emission import Emission
from hyjax.scene.relighter import LitFrame


def padded(lit: LitFrame, most: int) -> LitFrame:
    """A frame with lights that give nothing, up to so many, and with pixels that may shine.

    Its picture is the same. Compiling a cascade for each number of lights would take longer than running it.

    Args:
        lit: any.
        most: lights, at least as many as it has.
    """
    shaded, view = lit.shaded, lit.view.frame
    more, emission = most - shaded.illuminance.shape[-1], shaded.emission
    beside = ((0, 0), (0, 0), (0, more))
    if emission is None and shaded.photo_light is not None:
        emission = Emission(jnp.zeros((*view.shape[:2], 1)), jnp.zeros_like(view), jnp.zeros_like(view))
    shaded = dataclasses.replace(
        shaded,
        illuminance=jnp.pad(shaded.illuminance, beside),
        visibility=jnp.pad(shaded.visibility, beside, constant_values=1.0),
        colors=jnp.pad(shaded.colors, ((0, more), (0, 0))),
        emission=emission,
    )
    return dataclasses.replace(lit, shaded=shaded)
