"""Checks of numbers and rays that a browser sends."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from hyjax.util.errors import InputError, shown


def clamp_number(value: Any, low: float, high: float) -> float:
    """A number brought into [low, high]; the value nearest to 0 in that range if it is no finite number."""
    number = float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
    return min(max(number, low), high)


def checked_flag(value: Any) -> bool:
    """True or False; anything else is refused, for text such as "no" would count as true."""
    if not isinstance(value, bool):
        raise InputError(f"must be true or false, got {shown(value)}")
    return value


def check_rays(origin: Any, directions: Any) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "*n 3"]]:
    """Start of rays, and their directions as unit vectors."""
    try:
        start, rays = np.asarray(origin, float), np.asarray(directions, float)
    except (TypeError, ValueError):
        raise InputError("a ray must be numbers") from None
    if start.shape != (3,) or rays.shape[-1:] != (3,):
        raise InputError("a ray must have a start and a direction, three numbers each")
    lengths = np.linalg.norm(rays, axis=-1, keepdims=True)
    if not (np.isfinite(start).all() and np.isfinite(lengths).all() and (lengths > 0).all()):
        raise InputError("a ray must be finite numbers, and its direction not zero")
    return start, rays / lengths
