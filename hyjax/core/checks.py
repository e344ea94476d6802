"""Checks of the arguments of diffusion, where their values are known (not traced)."""

import weakref
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, ArrayLike, Float

from hyjax.core.cycles import stable_cycle
from hyjax.core.finite import LARGEST_VALUE
from hyjax.core.stencil import Edges
from hyjax.util.argument_kinds import described, is_numeric
from hyjax.util.errors import InputError, shown
from hyjax.util.tracing import concrete

_seen_edges: weakref.WeakValueDictionary[int, Array] = weakref.WeakValueDictionary()
"""Edges whose values have been looked at, which waits for them: once, and not for each step."""


def check_edges(y: Float[Array, "h w c"], edges: Edges) -> None:
    """Raise `InputError` unless the edges are conductances of a picture of y's size.

    Values known only while tracing are let through.

    >>> check_edges(jnp.ones((4, 5, 3)), (jnp.ones((3, 5)), jnp.ones((4, 4))))
    """
    h, w = y.shape[:2]
    if edges[0].shape != (h - 1, w) or edges[1].shape != (h, w - 1):
        raise InputError(
            f"edges: shapes {edges[0].shape} and {edges[1].shape} do not belong to a picture of {h}x{w} pixels, "
            f"which has {(h - 1, w)} and {(h, w - 1)}"
        )
    for given in edges:
        if _seen_edges.get(id(given)) is given or (values := concrete(given)) is None or not values.size:
            continue
        if not (values.min() >= 0 and values.max() <= 1):
            raise InputError(
                f"edges: conductances lie in [0, 1], as hyjax.conductance makes them, got {values.min():g} to "
                f"{values.max():g}"
            )
        if isinstance(given, Array):  # others may change
            _seen_edges[id(given)] = given


def check_kappa(kappa: Float[ArrayLike, ""], where: str = "kappa") -> None:
    """Raise `InputError` unless κ > 0. Values known only while tracing are let through.

    >>> check_kappa(0.0)
    Traceback (most recent call last):
    hyjax.util.errors.InputError: kappa: ...
    """
    value = _known_number(kappa, where)
    if value is not None and not (value > 0 and value < float("inf")):
        raise InputError(f"{where}: must be finite and > 0, got {value}")


def _known_number(value: Float[ArrayLike, ""], where: str) -> np.ndarray | None:
    """The number, or None while it is traced."""
    known = concrete(value)
    if known is not None and not (known.ndim == 0 and is_numeric(known)):
        raise InputError(f"{where}: must be a number, got {shown(value)}")
    return known


def check_fidelity(fidelity: Float[ArrayLike, ""], where: str = "fidelity") -> None:
    """Raise `InputError` unless α ≥ 0. Values known only while tracing are let through.

    >>> check_fidelity(-1.0)
    Traceback (most recent call last):
    hyjax.util.errors.InputError: fidelity: ...
    """
    value = _known_number(fidelity, where)
    if value is not None and not 0 <= value <= LARGEST_VALUE:
        limit = f"at most {LARGEST_VALUE:g}" if LARGEST_VALUE < value < np.inf else "finite"
        raise InputError(f"{where}: must be {limit} and >= 0, got {value}")


def check_step_sizes(
    step_sizes: Float[ArrayLike, "*n"] | Sequence[float], where: str = "lam", dtype: DTypeLike = jnp.float32
) -> None:
    """Raise `InputError` unless every λ is in (0, 1/4), or all λ form a stable cycle in this precision.

    Values known only while tracing are let through.

    >>> check_step_sizes(jnp.array([0.3]))
    Traceback (most recent call last):
    hyjax.util.errors.InputError: lam: ...
    """
    values = concrete(step_sizes)
    if values is None:
        return
    if not is_numeric(values):
        raise InputError(f"{where}: must be step sizes, got {described(values)}")
    bad = values[~((values > 0) & (values < 0.25))]
    if not bad.size or stable_cycle(values, dtype):
        return
    if stable_cycle(values, jnp.float64):
        raise InputError(
            f"{where}: these {values.size} steps amplify rounding errors too much for {jnp.dtype(dtype).name}; use "
            f"shorter cycles, or float32"
        )
    raise InputError(
        f"{where}: a step size must lie inside (0, 1/4) to be stable, or belong to a cycle as step_cycle makes it, "
        f"got {bad.flat[0]:g}"
    )
