"""Product of filter and frame (Eq. 1)."""

import jax
from jaxtyping import Array, Float

from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError


@checked_arguments
@jax.jit
def composite(relight_filter: Float[Array, "h w c"], frame: Float[Array, "h w 3"]) -> Float[Array, "h w 3"]:
    """Relit picture S = R ⊙ C (Eq. 1).

    Two linear images give the physically right product, two display-encoded ones the paper's.

    Args:
        relight_filter: R, one channel or three.
        frame: C, the camera's picture.

    Raises:
        InputError: the sizes differ.
    """
    if relight_filter.shape[:2] != frame.shape[:2] or relight_filter.shape[-1] not in (1, frame.shape[-1]):
        raise InputError(f"composite: filter {relight_filter.shape} does not fit the frame {frame.shape}")
    return relight_filter * frame
