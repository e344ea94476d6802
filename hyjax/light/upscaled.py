"""Joint upsampling of a picture that was relit at a smaller size, under the frame itself."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.finite import finite_or_zero
from hyjax.core.upsampling import guided_upsample
from hyjax.light.color import to_linear
from hyjax.light.compositing import composite
from hyjax.light.emission import Emission
from hyjax.light.relit import Relit
from hyjax.light.view import View


@functools.partial(jax.jit, static_argnames="factor")
def upscaled_picture(
    display: Float[Array, "h w 3"],
    view: View,
    relight_filter: Float[Array, "sh sw 3"],
    image: Float[Array, "sh sw 3"],
    emission: Emission | None,
    kappa: Float[ArrayLike, ""],
    *,
    factor: int,
) -> Float[Array, "h w 3"]:
    """Relit picture at full size, from the relight filter and the picture at the size over `factor`.

    The filter is interpolated under the frame, as a cascade's last level is, and the frame multiplied at full size:
    its texture stays. Emission is interpolated as it is.

    Args:
        display: the frame, display-encoded.
        kappa: κ of the interpolation, see `guided_upsample`.
        factor: ≥ 1.

    Source: Kopf, Cohen, Lischinski and Uyttendaele, *Joint bilateral upsampling*, SIGGRAPH 2007.
    """

    def whole(picture: Float[Array, "sh sw c"]) -> Float[Array, "h w c"]:
        return guided_upsample(picture, factor, display, kappa, coarse=view.display)

    relit = composite(whole(relight_filter), finite_or_zero(to_linear(display)))
    if emission is None:
        return relit
    shining = image - (1.0 - emission.weight) * composite(relight_filter, finite_or_zero(view.frame))
    # One by one: XLA on the CPU takes three times longer for all of them stacked, and then parted again.
    return (1.0 - whole(emission.weight)) * relit + whole(shining)


@functools.partial(jax.jit, static_argnames="factor")
def upscaled_stages(
    relit: Relit,
    display: Float[Array, "h w 3"],
    view: View,
    image: Float[Array, "h w 3"],
    kappa: Float[ArrayLike, ""],
    *,
    factor: int,
) -> Relit:
    """Stages at full size, for display; arguments as of `upscaled_picture`, with its result."""
    names = [field.name for field in dataclasses.fields(relit) if field.name != "image"]
    stacked = jnp.concatenate([getattr(relit, name) for name in names], axis=-1)
    upsampled = guided_upsample(stacked, factor, display, kappa, coarse=view.display)
    return Relit(**dict(zip(names, jnp.split(upsampled, len(names), axis=-1), strict=True)), image=image)
