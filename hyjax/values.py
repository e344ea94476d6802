"""Looking at values where they are known, which inside a traced function they are not."""

import jax
import numpy as np
from jaxtyping import ArrayLike


def concrete(value: ArrayLike) -> np.ndarray | None:
    """The numbers in `value`, or None while jax is tracing and there are none yet."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value)
