"""Concrete values of arrays, which are not known inside a traced function."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import ArrayLike


def concrete(value: ArrayLike | Sequence[float]) -> np.ndarray | None:
    """The numbers in `value`, or None while jax is tracing and there are none yet."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value)
