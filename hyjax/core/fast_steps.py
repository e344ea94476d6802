"""Eq. 2 on pictures with a rim of one pixel, many steps at once: the fastest backends of one core and of a GPU.

Conductances are zero on the rim, so that whatever stands there counts nothing, and every loop runs over pixels of
which none is special. In place, two buffers take turns: each step reads one and writes the inside of the other,
where XLA writes it without a copy. That is fastest on one core while the picture fits its cache; XLA does not share
it among cores, as it shares `hyjax.core.diffusion.explicit_step` repeated, which pays for large pictures. A GPU
loses its time between small kernels: there each turn of the loop has several steps, written out, and each becomes
one kernel. `hyjax.core.backends` chooses; `experiments.bench_peers` measures them.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hyjax.core.stencil import Edges

RIM = [(0, 0), (1, 1), (1, 1)]
"""Padding of a channels-first picture by a rim of one pixel."""
INNER_START = (0, 1, 1)
"""First element inside the rim."""
UNROLLED_STEPS = 8
"""Steps in a turn of the loop on a GPU. More take longer to compile."""
Step = Callable[[Float[Array, "c h+2 w+2"], Float[Array, ""]], Float[Array, "c h w"]]


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
    state, step = _begin(y, edges, fidelity, source)

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


@jax.jit
def steps_unrolled(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[Array, "n"],
    fidelity: Float[Array, ""] | None,
    source: Float[Array, "h w c"] | None,
) -> Float[Array, "h w c"]:
    """`steps_in_place`, for a GPU.

    >>> y, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> [round(float(x), 3) for x in steps_unrolled(y, edges, jnp.full(1, 0.2), None, None)[0, :, 0]]
    [0.2, 0.8]
    """
    state, step = _begin(y, edges, fidelity, source)
    unroll = max(1, min(UNROLLED_STEPS, len(step_sizes)))
    state, _ = jax.lax.scan(lambda x, lam: (step(jnp.pad(x, RIM), lam), None), state, step_sizes, unroll=unroll)
    return jnp.moveaxis(state, 0, -1)


def _begin(
    y: Float[Array, "h w c"], edges: Edges, fidelity: Float[Array, ""] | None, source: Float[Array, "h w c"] | None
) -> tuple[Float[Array, "c h w"], Step]:
    """The picture, channels first, and a step from one with its rim."""
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

    return state, step
