"""Eq. 2 in tiles, many steps in one launch: the backend for a GPU, which loses its time to small kernels.

The picture is cut into tiles that overlap by a halo as wide as there are steps in a launch. One block of threads
takes one channel of one tile, keeps it and its conductances in registers, and passes values between its threads
through a piece of memory of its own. What comes in from a tile's border is wrong, but in n steps no further than n
pixels, which the next tile has right. A picture that fits into one tile needs no halo and takes all its steps in
one launch. This is overlapped temporal tiling (Datta et al., *Stencil computation optimization and auto-tuning on
state-of-the-art multicore architectures*, SC 2008).

Not yet run on a GPU: tests compare it with the plain backend in Pallas's interpreter, and check that it lowers to
Triton's code. So `hyjax.diffuse` does not take it yet: see `hyjax.core.backends.select_backend`.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jaxtyping import Array, Float

from hyjax.core.stencil import Edges

TILE, HALO = 64, 8
"""Side of a tile, halo included, and steps in a launch."""
LARGEST_TILE = 128
"""Longest side, in pixels, of a picture that is one tile."""


@functools.partial(jax.jit, static_argnames="interpret")
def steps_in_tiles(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[Array, "n"],
    fidelity: Float[Array, ""] | None,
    source: Float[Array, "h w c"] | None,
    *,
    interpret: bool = False,
) -> Float[Array, "h w c"]:
    """`hyjax.diffuse`, to rounding, without its checks and its derivatives.

    >>> y, edges = jnp.array([[[0.0], [1.0]]]), (jnp.ones((0, 2)), jnp.ones((1, 1)))
    >>> stepped = steps_in_tiles(y, edges, jnp.full(1, 0.2), None, None, interpret=True)
    >>> [round(float(x), 3) for x in stepped[0, :, 0]]
    [0.2, 0.8]
    """
    if len(step_sizes) == 0:
        return y
    if fidelity is not None and source is None:
        source = y
    single = max(y.shape[:2]) <= LARGEST_TILE

    def launch(y: Float[Array, "h w c"], sizes: Float[Array, "k"]) -> tuple[Float[Array, "h w c"], None]:
        return _launch(y, edges, sizes, fidelity, source, single, interpret), None

    if single:
        return launch(y, step_sizes)[0]
    rest = len(step_sizes) % HALO
    full = step_sizes[: len(step_sizes) - rest].reshape(-1, HALO)
    if len(full):
        y, _ = jax.lax.scan(launch, y, full)
    return launch(y, step_sizes[-rest:])[0] if rest else y


def _launch(
    y: Float[Array, "h w c"],
    edges: Edges,
    step_sizes: Float[Array, "n"],
    fidelity: Float[Array, ""] | None,
    source: Float[Array, "h w c"] | None,
    single: bool,
    interpret: bool,
) -> Float[Array, "h w c"]:
    height, width, channels = y.shape
    halo = 0 if single else HALO
    tile = (pl.next_power_of_2(height), pl.next_power_of_2(width)) if single else (TILE, TILE)
    inner = tile[0] - 2 * halo, tile[1] - 2 * halo
    rows, columns = pl.cdiv(height, inner[0]), pl.cdiv(width, inner[1])
    after = rows * inner[0] - height + halo, columns * inner[1] - width + halo

    def padded(x: Float[Array, "... a b"], before: tuple[int, int], more: tuple[int, int]) -> Array:
        pads = [(0, 0)] * (x.ndim - 2) + [(halo + before[k], after[k] + more[k]) for k in (0, 1)]
        return jnp.pad(x.astype(y.dtype), pads)

    # vertical[i] lies above row i, horizontal[:, j] left of column j.
    inputs = [padded(jnp.moveaxis(y, -1, 0), (0, 0), (0, 0))]
    inputs += [padded(edges[0], (1, 0), (1, 0)), padded(edges[1], (0, 1), (0, 1)), step_sizes]
    if fidelity is not None and source is not None:
        inputs += [padded(jnp.moveaxis(source, -1, 0), (0, 0), (0, 0)), jnp.reshape(fidelity, (1,))]
    room = jax.ShapeDtypeStruct((channels, rows, columns, tile[0] + 2, tile[1] + 2), y.dtype)
    kernel = functools.partial(_kernel, tile=tile, inner=inner, wait=not interpret)
    options: dict[str, Any] = {"interpret": True} if interpret else {"compiler_params": _threads(tile)}
    tiles = pl.pallas_call(kernel, out_shape=room, grid=(channels, rows, columns), **options)(*inputs)
    tiles = tiles[..., 1 + halo : 1 + halo + inner[0], 1 + halo : 1 + halo + inner[1]]
    picture = jnp.moveaxis(tiles, 2, 3).reshape(channels, rows * inner[0], columns * inner[1])
    return jnp.moveaxis(picture[:, :height, :width], 0, -1)


def _kernel(*refs, tile: tuple[int, int], inner: tuple[int, int], wait: bool) -> None:  # type: ignore[no-untyped-def]
    y_ref, vertical_ref, horizontal_ref, sizes_ref, *rest, room = refs
    channel, i, j = (pl.program_id(k) for k in range(3))
    top, left = i * inner[0], j * inner[1]

    def window(down: int = 0, right: int = 0) -> tuple:
        return pl.ds(top + down, tile[0]), pl.ds(left + right, tile[1])

    def own(down: int, right: int) -> tuple:
        return channel, i, j, pl.ds(1 + down, tile[0]), pl.ds(1 + right, tile[1])

    around = [
        ((-1, 0), vertical_ref[window()]),
        ((1, 0), vertical_ref[window(1, 0)]),
        ((0, -1), horizontal_ref[window()]),
        ((0, 1), horizontal_ref[window(0, 1)]),
    ]
    data_term = (rest[0][(channel, *window())], rest[1][0]) if rest else None

    def step(k: Array, y: Array) -> Array:
        room[own(0, 0)] = y
        _wait(wait)
        # A select: around the tile stands anything, also what is no number.
        flows = [jnp.where(edge > 0, edge * (room[own(*shift)] - y), 0.0) for shift, edge in around]
        _wait(wait)
        lam = sizes_ref[k]
        new = y + lam * (flows[0] + flows[1] + flows[2] + flows[3])
        if data_term is None:
            return new.astype(y.dtype)
        weight = lam * data_term[1]
        return ((new + weight * data_term[0]) / (1.0 + weight)).astype(y.dtype)

    room[own(0, 0)] = jax.lax.fori_loop(0, sizes_ref.shape[0], step, y_ref[(channel, *window())])


def _threads(tile: tuple[int, int]) -> Any:
    """Number of threads as Triton's options: a warp for every 512 pixels, 16 a thread, up to 16 warps."""
    from jax.experimental.pallas import triton

    return triton.CompilerParams(num_warps=min(16, max(1, tile[0] * tile[1] // 512)))


def _wait(wait: bool) -> None:
    """Barrier of the threads of a block. The interpreter has but one thread."""
    if wait:
        from jax.experimental.pallas import triton

        triton.debug_barrier()
