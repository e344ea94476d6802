"""Checks of the arguments of metrics."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.util.errors import InputError
from hyjax.util.tracing import concrete

ROUND_OFF = 1e-4
"""Largest distance of a value from [0, 1]."""


def as_pictures(*, smallest: int = 1, **pictures: Float[ArrayLike, "h w c"]) -> list[Float[Array, "h w c"]]:
    """Convert float pictures of one size to arrays, all in [0, 1].

    >>> (picture,) = as_pictures(image=np.zeros((4, 5, 3), np.float32))
    >>> picture.shape
    (4, 5, 3)

    Args:
        smallest: least height and width.
        pictures: display values by their names in messages.
    """
    for name, picture in pictures.items():
        height, width, _ = jnp.shape(picture)
        if min(height, width) < smallest:
            raise InputError(f"{name}: must be at least {smallest} x {smallest} pixels, got {height} x {width}")
        _check_values(name, picture)
    return [jnp.asarray(picture) for picture in pictures.values()]


def _check_values(name: str, picture: Float[ArrayLike, "h w c"]) -> None:
    values = concrete(picture)
    if values is None:
        return
    low, high = float(values.min()), float(values.max())
    if np.isnan(low):  # both extremes are, if a single value is
        raise InputError(f"{name}: has values that are not numbers (NaN)")
    if low < -ROUND_OFF or high > 1.0 + ROUND_OFF:
        raise InputError(f"{name}: display values must lie in [0, 1], got {low:.6g} to {high:.6g}")


def check_valid(valid: Bool[ArrayLike, "h w"] | None, *, border: int = 0) -> None:
    """Raise `InputError` unless `valid` is None or a mask with a true pixel inside the border.

    >>> check_valid(np.zeros((4, 5), bool))
    Traceback (most recent call last):
    hyjax.util.errors.InputError: valid: no pixel is valid, so there is nothing to compare
    """
    values = None if valid is None else concrete(valid)
    inside = slice(border, -border or None)
    if values is not None and not values[inside, inside].any():
        place = f", {border} pixels or more from the border," if border else ""
        raise InputError(f"valid: no pixel{place} is valid, so there is nothing to compare")
