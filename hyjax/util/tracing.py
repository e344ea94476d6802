"""Concrete values of arrays, which a traced function does not know, and how its callers run it."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike

Run = Callable[..., Any]
"""Runner of a pure function, as `call` is: of its arrays by place and its static arguments by name."""


def concrete(value: ArrayLike | Sequence[float]) -> np.ndarray | None:
    """Concrete numbers of `value`; None while jax is tracing."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value)


def call(function: Callable[..., Any], *arrays: Any, **static: Any) -> Any:
    """Result of a function that is called as it is; a command reads its compiled program from a folder instead."""
    return function(*arrays, **static)
