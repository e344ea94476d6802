"""One function in several forms: a plain one to read and differentiate, others to be fast."""

import functools
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax

from hyjax.environment import cores
from hyjax.inplace import steps_in_place

MOST_VALUES = 2**18
"""Of a picture whose two buffers stay in a core's cache. Beyond it steps in place are no faster, and plain steps
are shared among cores. Measured on one core and on two; with more of them in proportion fewer."""
GPU_KERNEL = "HYJAX_GPU_KERNEL"
"""In the environment: 1 takes `hyjax.tiles` on a GPU, which was not measured on one yet."""


def with_fast_values(plain: Callable[..., Any], fast: Callable[..., Any]) -> Callable[..., Any]:
    """`fast` for values, `plain` for derivatives of any order, forwards and backwards, and values beside them.

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


def fastest(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Repeated steps of diffusion in the form that runs fastest on the platform that they are compiled for.

    Chosen while tracing: the number of cores and the environment count as they are then. Under `vmap` the size is
    that of one picture.

    Args:
        plain: the steps in their plain form, with the arguments of `steps_in_place`.
    """

    def choose(*arguments: Any) -> Any:
        forms: dict[str, Callable[..., Any]] = {}
        if arguments[0].size * max(1, cores() - 1) <= MOST_VALUES:
            forms["cpu"] = steps_in_place
        if os.environ.get(GPU_KERNEL) == "1":
            from hyjax.tiles import steps_in_tiles

            forms["cuda"] = steps_in_tiles
        return jax.lax.platform_dependent(*arguments, **forms, default=plain) if forms else plain(*arguments)

    return choose
