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
    frame = finite_or_zero(to_linear(display))
    if emission is None:
        upsampled = guided_upsample(relight_filter, factor, display, kappa, coarse=view.display)
        return upsampled, composite(upsampled, frame)
    shining = image - (1.0 - emission.weight) * composite(relight_filter, finite_or_zero(view.frame))
    stacked = jnp.concatenate([relight_filter, shining, emission.weight], axis=-1)
    upsampled = guided_upsample(stacked, factor, display, kappa, coarse=view.display)
    relight_filter, shining, weight = upsampled[..., :3], upsampled[..., 3:6], upsampled[..., 6:]
    return relight_filter, (1.0 - weight) * composite(relight_filter, frame) + shining


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
