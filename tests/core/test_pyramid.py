"""Cell means, bilinear interpolation and pooled conductances, and that walls hold at every level."""

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import paper
from reference.differences import assert_gradients

from hyjax import InputError, conductance, downsample, min_pool, upsample
from hyjax.core.diffusion import edge_stopping, guide_distance
from hyjax.core.pyramid import cell_pyramid, level_shape, max_pool

pytestmark = pytest.mark.usefixtures("strict_ranks")

FACTORS = [1, 2, 3, 4, 5, 8, 16]
SIZES = [(1, 1), (1, 7), (6, 1), (5, 12), (9, 10), (17, 13)]
seeds = st.integers(0, 2**31)


def picture(seed: int, size: tuple[int, int], channels: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 2.0, (*size, channels))


def random_edges(seed: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(size=(size[0] - 1, size[1])), rng.uniform(size=(size[0], size[1] - 1))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("factor", FACTORS)
def test_against_the_literal_form(size: tuple[int, int], factor: int) -> None:
    y, edges = picture(factor, size), random_edges(factor, size)
    with jax.enable_x64(True):
        down = downsample(jnp.asarray(y), factor)
        np.testing.assert_allclose(down, paper.downsample(y, factor), rtol=1e-13, atol=1e-14)
        up = upsample(down, factor, size)
        np.testing.assert_allclose(up, paper.upsample(np.asarray(down), factor, size), rtol=1e-12, atol=1e-13)
        assert up.dtype == down.dtype == np.float64
        pooled = min_pool(tuple(map(jnp.asarray, edges)), factor)
        for got, want in zip(pooled, paper.min_pool(edges, factor), strict=True):
            np.testing.assert_array_equal(got, want)
    rows, columns = level_shape(size, factor)
    assert down.shape == (rows, columns, 2)
    assert [e.shape for e in pooled] == [(rows - 1, columns), (rows, columns - 1)]


@pytest.mark.parametrize("size", [(1, 7), (17, 13)])
def test_cell_pyramid_is_downsample(size: tuple[int, int]) -> None:
    """Also from finer cells that are cut off at the border."""
    factors, y = [16, 8, 6, 4, 3, 1], picture(0, size)
    with jax.enable_x64(True):
        got = jax.jit(lambda y: cell_pyramid(y, factors))(jnp.asarray(y))
        assert sorted(got) == sorted(factors)
        for factor, cells in got.items():
            np.testing.assert_allclose(cells, paper.downsample(y, factor), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("norm", ["l2", "mean_abs"])
@pytest.mark.parametrize("factor", [2, 3, 16])
def test_pooling_distances_is_pooling_conductances(factor: int, norm: str) -> None:
    """Eq. 3 of the largest distance is the smallest conductance."""
    guide = jnp.asarray(picture(0, (17, 13), 3), jnp.float32)
    fast = edge_stopping(max_pool(guide_distance(guide, norm=norm), factor), 0.7)
    plain = min_pool(conductance(guide, 0.7, norm=norm), factor)
    for a, b in zip(fast, plain, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


@pytest.mark.parametrize("factor", [2, 3, 4, 5])
def test_symmetry(factor: int) -> None:
    """Flips of a divisible size and transposes of any commute with all three."""
    size = (factor * 4, factor * 3)
    y, edges = picture(1, size), random_edges(1, size)
    with jax.enable_x64(True):
        down, pooled = downsample(jnp.asarray(y), factor), min_pool(tuple(map(jnp.asarray, edges)), factor)
        np.testing.assert_allclose(downsample(jnp.asarray(y[::-1, ::-1]), factor), down[::-1, ::-1], rtol=1e-12)
        up = upsample(down, factor, size)
        np.testing.assert_allclose(upsample(down[::-1, ::-1], factor, size), up[::-1, ::-1], rtol=1e-12)
        flipped = min_pool(tuple(jnp.asarray(e[::-1, ::-1]) for e in edges), factor)
        transposed = min_pool((jnp.asarray(edges[1].T), jnp.asarray(edges[0].T)), factor)
    for k in (0, 1):
        np.testing.assert_array_equal(flipped[k], pooled[k][::-1, ::-1])
        np.testing.assert_array_equal(transposed[1 - k], pooled[k].T)


def walls(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges between pixels of different label are zero, all others one."""
    return (
        (labels[1:] == labels[:-1]).astype(np.float32),
        (labels[:, 1:] == labels[:, :-1]).astype(np.float32),
    )


def reachable(edges: tuple[np.ndarray, np.ndarray], start: np.ndarray) -> np.ndarray:
    """Cells that some path of non-zero edges joins to a cell of `start`."""
    vertical, horizontal = (np.asarray(e) > 0 for e in edges)
    h, w = start.shape
    seen, queue = start.copy(), deque(map(tuple, np.argwhere(start)))
    while queue:
        i, j = queue.popleft()
        for a, b, free in (
            (i + 1, j, i + 1 < h and vertical[i, j]),
            (i - 1, j, i > 0 and vertical[i - 1, j]),
            (i, j + 1, j + 1 < w and horizontal[i, j]),
            (i, j - 1, j > 0 and horizontal[i, j - 1]),
        ):
            if free and not seen[a, b]:
                seen[a, b] = True
                queue.append((a, b))
    return seen


def assert_walls_hold(labels: np.ndarray) -> int:
    """At every factor; returns how many pure cells were looked at."""
    cells = 0
    for factor in FACTORS:
        pooled = min_pool(tuple(map(jnp.asarray, walls(labels))), factor)
        share = paper.downsample(labels[..., None].astype(float), factor)[..., 0]
        inside, outside = share == 1.0, share == 0.0
        crossed = reachable(pooled, inside) & outside
        assert not crossed.any(), f"factor {factor}: leaks into cells {np.argwhere(crossed).tolist()}"
        cells += int(inside.sum() + outside.sum())
    return cells


@pytest.mark.parametrize("shift", range(8))
def test_straight_and_staircase_walls_hold(shift: int) -> None:
    i, j = np.mgrid[:37, :41]
    for labels in (i < 12 + shift, j < 9 + shift, i + j < 30 + shift, i - j < shift - 3, 2 * i + j < 45 + shift):
        assert assert_walls_hold(labels) > 100


@given(seeds, st.floats(0.5, 4.0))
def test_closed_curves_of_any_shape_hold(seed: int, smoothness: float) -> None:
    """The outlines of a thresholded smooth noise: many closed and border-to-border curves at once."""
    rng = np.random.default_rng(seed)
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / smoothness) ** 2)
    noise = rng.normal(size=(37, 41))
    for axis in (0, 1):
        noise = np.apply_along_axis(np.convolve, axis, noise, kernel, mode="same")
    assert_walls_hold(noise > 0)


@given(seeds)
def test_random_blobs_hold(seed: int) -> None:
    """A region grown pixel by pixel: as ragged a simple outline as the grid has."""
    rng = np.random.default_rng(seed)
    labels = np.zeros((37, 41), bool)
    labels[18, 20] = True
    for _ in range(600):
        i, j = rng.choice(np.argwhere(labels))
        a, b = np.add((i, j), rng.choice([(0, 1), (1, 0), (0, -1), (-1, 0)]))
        if 0 <= a < 37 and 0 <= b < 41:
            labels[a, b] = True
    assert_walls_hold(labels)


@pytest.mark.parametrize("factor", FACTORS)
def test_open_space_stays_open(factor: int) -> None:
    """Pooling must not block more than it has to: one zero edge touches two coarse edges at most."""
    vertical, horizontal = np.ones((31, 32), np.float32), np.ones((32, 31), np.float32)
    vertical[15, 9] = 0.0
    pooled = min_pool((jnp.asarray(vertical), jnp.asarray(horizontal)), factor)
    assert np.all(np.asarray(pooled[1]) == 1.0)
    # Edge 15 | 16 is the border of two cells for factors that divide 16; for even ones that do not it may lie on a
    # centre line and count twice.
    assert np.sum(np.asarray(pooled[0]) == 0.0) == 1


def test_an_edge_on_a_centre_line_counts_for_both_sides() -> None:
    vertical = np.ones((11, 4), np.float32)
    vertical[5] = 0.0  # between rows 5 and 6: the middle of the second cell of four
    pooled = min_pool((jnp.asarray(vertical), jnp.ones((12, 3))), 4)[0]
    np.testing.assert_array_equal(pooled, [[0.0], [0.0]])


@pytest.mark.parametrize("factor", FACTORS)
def test_a_linear_ramp_keeps_its_place(factor: int) -> None:
    """Down and up again gives the ramp back between the outermost cell centres: no half-pixel drift."""
    size = (factor * 4, factor * 5)
    i, j = np.mgrid[: size[0], : size[1]]
    ramp = (0.3 * i - 0.7 * j + 2.0)[..., None]
    with jax.enable_x64(True):
        down = downsample(jnp.asarray(ramp), factor)
        there_and_back = np.asarray(upsample(down, factor, size))
        inner = slice(factor // 2, -(factor // 2) or None)
        np.testing.assert_allclose(there_and_back[inner, inner], ramp[inner, inner], rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(there_and_back.mean(), ramp.mean(), rtol=1e-12)
        # constant beyond the outermost centres
        np.testing.assert_allclose(there_and_back[0, 0], down[0, 0], rtol=1e-12)
        y = picture(factor, size)
        mean = np.mean(upsample(downsample(jnp.asarray(y), factor), factor, size), axis=(0, 1))
        np.testing.assert_allclose(mean, y.mean(axis=(0, 1)), rtol=1e-12, atol=1e-13)


def test_coarse_to_fine_in_two_hops_keeps_the_ramp() -> None:
    ramp = jnp.arange(32.0)[:, None, None] * jnp.ones((1, 3, 1))
    half_way = upsample(downsample(ramp, 8), 4, (16, 2))
    np.testing.assert_allclose(half_way[3:13], downsample(ramp, 2)[3:13], rtol=1e-6)


@pytest.mark.parametrize("factor", FACTORS)
def test_constants_stay(factor: int) -> None:
    y = jnp.full((17, 13, 1), 0.3)
    np.testing.assert_allclose(upsample(downsample(y, factor), factor, (17, 13)), y, rtol=3e-7)


def test_bad_factors_and_shapes_are_refused() -> None:
    y, edges = jnp.zeros((5, 7, 1)), (jnp.ones((4, 7)), jnp.ones((5, 6)))
    for factor in (0, -2):
        message = rf"(?m)^factor: must be a whole number in 1..{1 << 30}, got {factor}$"
        for call in (
            lambda f=factor: downsample(y, f),
            lambda f=factor: upsample(y, f, (5, 7)),
            lambda f=factor: min_pool(edges, f),
            lambda f=factor: max_pool(edges, f),
        ):
            with pytest.raises(InputError, match=message):
                call()
    for shape in ((10, 15), (8, 14), (11, 14), (5, 7)):
        with pytest.raises(
            InputError, match=rf"(?m)^shape: 5x7 cells times 2 do not make .* {shape[0]}x{shape[1]}$"
        ):
            upsample(y, 2, shape)
    assert upsample(y, 2, (9, 13)).shape == (9, 13, 1)


FAR = [(17, (40, 33)), (18, (37, 19)), (32, (100, 64)), (33, (34, 7)), (40, (101, 67)), (64, (5, 130))]


@pytest.mark.parametrize("factor,size", FAR)
def test_a_far_coarser_level_interpolates_as_the_paper_says(factor: int, size: tuple[int, int]) -> None:
    """Beyond the ratio that is written out by phases: same result, also for one cell, odd ratios and in a batch."""
    cells = picture(factor, (-(-size[0] // factor), -(-size[1] // factor)))
    want = paper.upsample(cells, factor, size)
    with jax.enable_x64(True):
        got = upsample(jnp.asarray(cells), factor, size)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-13)
        batch = jax.vmap(lambda y: upsample(y, factor, size))(jnp.stack([cells, 2 * cells]))
        np.testing.assert_allclose(batch, [want, 2 * want], rtol=1e-12, atol=1e-13)
        assert_gradients(lambda y: jnp.sum(jnp.sin(upsample(y, factor, size))), jnp.asarray(cells))


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
@pytest.mark.parametrize("factor,size", FAR)
def test_far_upsampling_keeps_constants_and_order(factor: int, size: tuple[int, int], dtype: str) -> None:
    rows, columns = -(-size[0] // factor), -(-size[1] // factor)
    constant = jnp.full((rows, columns, 1), 0.3, dtype)
    got = upsample(constant, factor, size)
    assert got.dtype == dtype and (got == jnp.full((*size, 1), 0.3, dtype)).all()
    rising = jnp.arange(rows * columns, dtype=dtype).reshape(rows, columns, 1) / 7
    rounding = float(jnp.finfo(dtype).eps * rising.max())
    for axis in (0, 1):
        slopes = np.diff(np.asarray(upsample(rising, factor, size), np.float32), axis=axis)
        assert (slopes >= -rounding).all()


def test_a_cell_far_larger_than_the_picture_is_no_trouble() -> None:
    y = jnp.full((1, 1, 3), 0.3)
    assert (upsample(y, 10**9, (4, 5)) == jnp.full((4, 5, 3), 0.3)).all()
