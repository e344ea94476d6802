"""Gradients against central finite differences, in float64."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def assert_gradients(
    function: Callable[..., Any],
    *arguments: Any,
    given: tuple[Any, ...] = (),
    eps: float = 1e-6,
    rtol: float = 1e-5,
    atol: float = 1e-8,
) -> Any:
    """Compare jax.grad of a scalar `function` with differences, in two random directions of every array leaf.

    Call it under `jax.enable_x64(True)`. Each leaf is moved by itself, so that a wrong gradient of a small one (a
    single κ) cannot hide behind a large one (a whole guide); each gradient must also be finite and not all zero.
    What is `given` follows the arguments and stays as it is.

    Returns:
        The gradient, with the structure of `arguments`.
    """
    function = jax.jit(function)
    leaves, structure = jax.tree.flatten(arguments)
    leaves = [jnp.asarray(leaf, jnp.float64) for leaf in leaves]

    def value(leaves: list[jax.Array], given: tuple[Any, ...]) -> jax.Array:
        return function(*jax.tree.unflatten(structure, leaves), *given)

    gradient = jax.jit(jax.grad(value))(leaves, given)
    rng = np.random.default_rng(0)
    for index, leaf in enumerate(leaves):
        assert np.all(np.isfinite(gradient[index])), f"leaf {index}: gradient not finite"
        assert np.any(np.asarray(gradient[index]) != 0), f"leaf {index}: gradient is zero"
        for _ in range(2 if leaf.size > 1 else 1):
            direction = rng.normal(size=leaf.shape)

            def along(step: float, index: int = index, direction: np.ndarray = direction) -> float:
                moved = [*leaves]
                moved[index] = leaves[index] + step * direction
                return float(value(moved, given))

            numeric = (along(eps) - along(-eps)) / (2 * eps)
            np.testing.assert_allclose(
                np.sum(np.asarray(gradient[index]) * direction),
                numeric,
                rtol=rtol,
                atol=atol,
                err_msg=f"leaf {index}",
            )
    return jax.tree.unflatten(structure, gradient)
