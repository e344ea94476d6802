"""Backends of one function: a plain one to read and differentiate, others to be fast."""

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax

from hyjax.core.inplace import steps_in_place
from hyjax.util.environment import cores

MOST_VALUES = 2**18
"""Of a picture whose two buffers stay in a core's cache. Beyond it steps in place are no faster, and plain steps
are shared among cores. Measured on one core and on two; with more of them in proportion fewer."""
GPU_KERNEL = "HYJAX_GPU_KERNEL"
"""In the environment: 1 takes `hyjax.core.tiles` on a GPU, which was not measured on one yet."""


def with_fast_values(plain: Callable[..., Any], fast: Callable[..., Any]) -> Callable[..., Any]:
    """`fast` for values, `plain` for derivatives of any order, forwards and backwards, and values beside them.

    >>> square = with_fast_values(lambda x: x * x, lambda x: x**2)
    >>> float(square(3.0)), float(jax.grad(square)(3.0))
    (9.0, 6.0)

    Args:
        plain: a function of arrays, or pytrees of them.
        fast: another that computes the same.
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
    """Repeated steps of diffusion by the fastest backend of the platform that they are compiled for.

    Chosen while tracing: the number of cores and the environment count as they are then. Under `vmap` the size is
    that of one picture.

    >>> import jax.numpy as jnp
    >>> steps = select_backend(lambda y, edges, step_sizes, fidelity, source: y)
    >>> edges = jnp.ones((3, 4)), jnp.ones((4, 3))
    >>> steps(jnp.ones((4, 4, 1)), edges, jnp.full(2, 0.2), None, None).shape
    (4, 4, 1)

    Args:
        plain: the plain backend, with the arguments of `steps_in_place`.
    """

    def choose(*arguments: Any) -> Any:
        backends: dict[str, Callable[..., Any]] = {}
        if arguments[0].size * max(1, cores() - 1) <= MOST_VALUES:
            backends["cpu"] = steps_in_place
        if os.environ.get(GPU_KERNEL) == "1":
            from hyjax.core.tiles import steps_in_tiles

            backends["cuda"] = steps_in_tiles
        return jax.lax.platform_dependent(*arguments, **backends, default=plain) if backends else plain(*arguments)

    return choose
