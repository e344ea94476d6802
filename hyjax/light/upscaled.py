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
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"]]:
    """Relight filter and relit picture at full size, from both at the size over `factor`.

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

    large, frame = whole(relight_filter), finite_or_zero(to_linear(display))
    relit = composite(large, frame)
    if emission is None:
        return large, relit
    shining = image - (1.0 - emission.weight) * composite(relight_filter, finite_or_zero(view.frame))
    # One by one: XLA on the CPU takes three times longer for all of them stacked, and then parted again.
    return large, (1.0 - whole(emission.weight)) * relit + whole(shining)


@functools.partial(jax.jit, static_argnames="factor")
def upscaled_stages(
    relit: Relit,
    display: Float[Array, "h w 3"],
    view: View,
    relight_filter: Float[Array, "h w 3"],
    image: Float[Array, "h w 3"],
    kappa: Float[ArrayLike, ""],
    *,
    factor: int,
) -> Relit:
    """Stages at full size, for display; arguments as of `upscaled_picture`, with its results."""
    kept = {field.name: getattr(relit, field.name) for field in dataclasses.fields(relit)}
    names = [name for name in kept if name not in ("relight_filter", "image")]
    stacked = jnp.concatenate([kept[name] for name in names], axis=-1)
    upsampled = guided_upsample(stacked, factor, display, kappa, coarse=view.display)
    pictures = dict(zip(names, jnp.split(upsampled, len(names), axis=-1), strict=True))
    return Relit(**pictures, relight_filter=relight_filter, image=image)
