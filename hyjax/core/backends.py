"""Backends of one function: a plain one to read and differentiate, fast ones for values."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax

from hyjax.core.fast_steps import steps_in_place, steps_unrolled
from hyjax.util.cores import cores

MOST_VALUES = 2**18
"""Most values of a picture whose two buffers stay in a core's cache. Beyond it steps in place are no faster, and
plain steps are shared among cores. Measured on one core and on two; with more of them in proportion fewer."""


def with_fast_values(plain: Callable[..., Any], fast: Callable[..., Any]) -> Callable[..., Any]:
    """Function that computes values by `fast`, derivatives of any order and their primal values by `plain`.

    >>> square = with_fast_values(lambda x: x * x, lambda x: x**2)
    >>> float(square(3.0)), float(jax.grad(square)(3.0))
    (9.0, 6.0)
    """
    function = jax.custom_jvp(fast)

    @functools.partial(function.defjvp, symbolic_zeros=True)
    def rule(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[Any, Any]:
        values, tree = jax.tree.flatten(tuple(primals))
        slopes = jax.tree.leaves(tuple(tangents))
        moved = [k for k, slope in enumerate(slopes) if not isinstance(slope, jax.custom_derivatives.SymbolicZero)]

        def of_moved(*moving: Any) -> Any:
            inputs = list(values)
            for k, value in zip(moved, moving):
                inputs[k] = value
            return plain(*jax.tree.unflatten(tree, inputs))

        return jax.jvp(of_moved, [values[k] for k in moved], [slopes[k] for k in moved])

    return function


def select_backend(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Return repeated steps of diffusion by the fastest backend of the platform that they are compiled for.

    Chosen while tracing: cores and a GPU count as they are then. Under `vmap` the size is that of one picture.

    >>> import jax.numpy as jnp
    >>> steps = select_backend(lambda y, edges, step_sizes, fidelity, source: y)
    >>> edges = jnp.ones((3, 4)), jnp.ones((4, 3))
    >>> steps(jnp.ones((4, 4, 1)), edges, jnp.full(2, 0.2), None, None).shape
    (4, 4, 1)
    """

    def choose(*arguments: Any) -> Any:
        backends: dict[str, Callable[..., Any]] = {}
        if arguments[0].size * max(1, cores() - 1) <= MOST_VALUES:
            backends["cpu"] = steps_in_place
        if jax.default_backend() == "gpu":
            backends["cuda"] = steps_unrolled
        return jax.lax.platform_dependent(*arguments, **backends, default=plain) if backends else plain(*arguments)

    return choose
