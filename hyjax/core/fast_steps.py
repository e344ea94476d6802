"""Eq. 2 in place, many steps at once: the fastest backend on one core while the picture fits its cache.

Two buffers with a rim of one pixel take turns: each step reads one and writes the inside of the other, where XLA
writes it without a copy, and every loop runs over pixels of which none is special. Conductances are zero on the
rim, so that whatever stands there counts nothing. XLA does not share this among cores, as it shares
`hyjax.core.diffusion.explicit_step` repeated, which pays for large pictures. `hyjax.core.backends` chooses;
`experiments.bench_peers` measures both.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.core.stencil import Edges

RIM = [(0, 0), (1, 1), (1, 1)]
"""Padding of a channels-first picture by a rim of one pixel."""
INNER_START = (0, 1, 1)
"""First element inside the rim."""


@jax.jit
def steps_in_place(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[Array, "n"],
    fidelity: Float[Array, ""] | None,
    source: Float[Array, "h w c"] | None,
) -> Float[Array, "h w c"]:
    """`hyjax.diffuse`, to rounding, without its checks and its derivatives.

    >>> y, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 3) for x in steps_in_place(y, edges, jnp.full(1, 0.2), None, None)[0, :, 0]]
    [0.2, 0.8]

    Args:
        step_sizes: λ of each step.
        source: what the data term pulls to; None for `y`.
    """
    state = jnp.moveaxis(y, -1, 0)
    vertical, horizontal = (jnp.pad(edge.astype(y.dtype), 1)[None] for edge in edges)
    above, below = vertical[:, :-1, 1:-1], vertical[:, 1:, 1:-1]
    left, right = horizontal[:, 1:-1, :-1], horizontal[:, 1:-1, 1:]
    target = None if fidelity is None else state if source is None else jnp.moveaxis(source, -1, 0)

    def step(x: Float[Array, "c h+2 w+2"], lam: Float[Array, ""]) -> Float[Array, "c h w"]:
        inside = x[:, 1:-1, 1:-1]
        inflow = (
            below * (x[:, 2:, 1:-1] - inside)
            + above * (x[:, :-2, 1:-1] - inside)
            + right * (x[:, 1:-1, 2:] - inside)
            + left * (x[:, 1:-1, :-2] - inside)
        )
        if target is None or fidelity is None:
            return inside + lam * inflow
        weight = lam * fidelity
        return ((inside + lam * inflow + weight * target) / (1.0 + weight)).astype(x.dtype)

    def write(new: Float[Array, "c h w"], buffer: Float[Array, "c h+2 w+2"]) -> Float[Array, "c h+2 w+2"]:
        return jax.lax.dynamic_update_slice(buffer, new, INNER_START)

    def two_steps(buffers: tuple[Array, Array], lams: Float[Array, "2"]) -> tuple[tuple[Array, Array], None]:
        first, second = buffers
        second = write(step(first, lams[0]), second)
        first = write(step(second, lams[1]), first)
        return (first, second), None

    buffer = jnp.pad(state, RIM)
    count = len(step_sizes)
    if count > 1:
        pairs = step_sizes[: count - count % 2].reshape(-1, 2)
        (buffer, _), _ = jax.lax.scan(two_steps, (buffer, buffer), pairs)
    state = step(buffer, step_sizes[-1]) if count % 2 else buffer[:, 1:-1, 1:-1]
    return jnp.moveaxis(state, 0, -1)
