"""Checks of the arguments of metrics."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from hyjax.util.errors import InputError
from hyjax.util.tracing import concrete

ROUND_OFF = 1e-4
"""Largest distance of a value from [0, 1]."""


def as_pictures(
    *, channels: int | None = None, smallest: int = 1, **pictures: Float[ArrayLike, "h w c"]
) -> list[Float[Array, "h w c"]]:
    """Convert pictures to arrays, all of one size and in [0, 1].

    >>> (picture,) = as_pictures(image=np.zeros((4, 5, 3), np.float32))
    >>> picture.shape
    (4, 5, 3)

    Args:
        channels: required number; None for any number.
        smallest: least height and width.
        pictures: display values by their names in messages.
    """
    shapes = {name: jnp.shape(picture) for name, picture in pictures.items()}
    for name, picture in pictures.items():
        shape, kind = shapes[name], jnp.result_type(picture)
        if len(shape) != 3 or shape[2] != (channels or shape[2]) or 0 in shape:
            raise InputError(f"{name}: must be a picture of shape H x W x {channels or 'C'}, got shape {shape}")
        if min(shape[:2]) < smallest:
            raise InputError(
                f"{name}: must be at least {smallest} x {smallest} pixels, got {shape[0]} x {shape[1]}"
            )
        if not jnp.issubdtype(kind, jnp.floating):
            raise InputError(f"{name}: must hold floats in [0, 1], got {kind} (8-bit values: divide by 255)")
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InputError(f"pictures must be of the same shape, got {listed}")
    for name, picture in pictures.items():
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


def check_valid(valid: Bool[ArrayLike, "h w"] | None, shape: tuple[int, ...], *, border: int = 0) -> None:
    """Raise `InputError` unless `valid` is None or a mask of this shape with a true pixel inside the border.

    >>> check_valid(np.zeros((4, 5), bool), (4, 5))
    Traceback (most recent call last):
    hyjax.util.errors.InputError: valid: no pixel is valid, so there is nothing to compare
    """
    if valid is None:
        return
    if jnp.shape(valid) != shape or jnp.result_type(valid) != jnp.bool_:
        got = f"{jnp.result_type(valid)} of shape {jnp.shape(valid)}"
        raise InputError(f"valid: must be booleans of shape {shape}, got {got}")
    values = concrete(valid)
    if values is not None and not values[border : shape[0] - border, border : shape[1] - border].any():
        place = f", {border} pixels or more from the border," if border else ""
        raise InputError(f"valid: no pixel{place} is valid, so there is nothing to compare")
