"""Joint upsampling of a picture that was relit at a smaller size, under the frame itself."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.upsampling import guided_upsample
from hyjax.light.color import to_linear
from hyjax.light.emission import Emission
from hyjax.light.relit import Relit, finished, framed, with_emission
from hyjax.light.view import View


@jax.jit
def upscaled_picture(
    view: View,
    relight_filter: Float[Array, "h w 3"],
    light: Float[Array, "h w 3"],
    emission: Emission | None,
    kappa: Float[ArrayLike, ""],
) -> tuple[Float[Array, "fh fw 3"], Float[Array, "fh fw 3"]]:
    """Relight filter and relit picture at full size, from those of `filter_and_light` at the size over `factor`.

    Both are interpolated under the frame, as a cascade's last level is, and the frame multiplied at full size: its
    texture stays. Emission is of full size.

    Args:
        view: with the full picture.
        kappa: κ of the interpolation, see `guided_upsample`.

    Source: Kopf, Cohen, Lischinski and Uyttendaele, *Joint bilateral upsampling*, SIGGRAPH 2007.
    """
    assert view.full is not None
    relight_filter = _whole(view, relight_filter, kappa)
    light = relight_filter if emission is None else _whole(view, light, kappa)  # unused without emission
    return finished(to_linear(view.full), relight_filter, light, emission)


@jax.jit
def upscaled_stages(
    small: Relit,
    view: View,
    light: Float[Array, "h w 3"],
    emission: Emission | None,
    whole: tuple[Float[Array, "fh fw 3"], Float[Array, "fh fw 3"]],
    kappa: Float[ArrayLike, ""],
) -> Relit:
    """Stages at full size, for display; arguments and results of `upscaled_picture`."""
    stages = [small.shading, small.refined, small.visibility, small.unrefined, light]
    stacked = _whole(view, jnp.concatenate(stages, axis=-1), kappa)
    shading, refined, visibility, unrefined, shadowed = jnp.split(stacked, len(stages), axis=-1)
    refined = framed(refined, shadowed / jnp.maximum(visibility, 1e-6), emission)
    unrefined = with_emission(unrefined, shadowed, emission)
    return Relit(shading, refined, visibility, whole[0], unrefined, whole[1])


def _whole(view: View, picture: Float[Array, "h w c"], kappa: Float[ArrayLike, ""]) -> Float[Array, "fh fw c"]:
    """Picture at full size."""
    assert view.full is not None
    return guided_upsample(picture, view.factor, view.full, kappa, coarse=view.display)
