"""Guided upsampling against the literal form, and that it is sharp where the guide has an edge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import paper
from reference.differences import assert_gradients

from hyjax import InputError, downsample, guided_upsample, upsample

# Few, as every one is compiled anew: odd and even factors, whole cells and cut ones, lines, a single cell.
SHAPES = [((9, 12), 3), ((17, 13), 4), ((1, 7), 4), ((6, 1), 5), ((1, 1), 16), ((3, 20), 17)]
shapes = st.sampled_from(SHAPES)
seeds = st.integers(0, 2**31)
kappas = st.floats(0.01, 10.0)
NORMS = ["l2", "mean_abs"]


def picture(seed: int, size: tuple[int, int], channels: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 2.0, (*size, channels))


def cells_of(seed: int, size: tuple[int, int], factor: int) -> np.ndarray:
    return picture(seed, (-(-size[0] // factor), -(-size[1] // factor)))


def literal(y: np.ndarray, factor: int, guide: np.ndarray, kappa: float, norm: str) -> np.ndarray:
    """Bilinear weights of the four nearest cells times κ² / (κ² + d²) of pixel and cell, pixel by pixel."""

    def c(p: np.ndarray, n: np.ndarray) -> float:
        return float(paper.conductance(np.stack([p, n])[None], kappa, norm)[1][0, 0])

    def neighbours(i: int, cells: int) -> list[tuple[int, float]]:
        place = min(max((i + 0.5) / factor - 0.5, 0.0), cells - 1.0)  # the centre of cell k is at k
        return [(int(place), 1 - place % 1), (min(int(place) + 1, cells - 1), place % 1)]

    coarse, result = paper.downsample(guide, factor), np.empty((*guide.shape[:2], y.shape[-1]))
    for i, j in np.ndindex(guide.shape[:2]):
        near = [(k, m, a * b) for k, a in neighbours(i, y.shape[0]) for m, b in neighbours(j, y.shape[1])]
        weights = np.array([w * c(guide[i, j], coarse[k, m]) for k, m, w in near])
        result[i, j] = weights @ np.array([y[k, m] for k, m, _ in near]) / weights.sum()
    return result


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize(("size", "factor"), SHAPES)
def test_against_the_literal_form(size: tuple[int, int], factor: int, norm: str) -> None:
    for seed, kappa in enumerate((0.05, 0.4, 8.0)):
        y, guide = cells_of(seed, size, factor), picture(seed + 9, size, 3)
        expected = literal(y, factor, guide, kappa, norm)
        with jax.enable_x64(True):
            got = guided_upsample(jnp.asarray(y), factor, jnp.asarray(guide), kappa, norm=norm)
            assert got.dtype == np.float64
            np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-12)
        y32, guide32 = jnp.asarray(y, jnp.float32), jnp.asarray(guide, jnp.float32)
        got = guided_upsample(y32, factor, guide32, kappa, norm=norm)
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, expected, atol=2e-4 if kappa < 0.1 else 1e-5)


@given(shapes, seeds, kappas)
def test_under_a_constant_guide_it_is_bilinear(shape: tuple, seed: int, kappa: float) -> None:
    size, factor = shape
    with jax.enable_x64(True):
        y = jnp.asarray(cells_of(seed, size, factor))
        guide = jnp.broadcast_to(jnp.asarray(picture(seed, (1, 1), 3)), (*size, 3))
        expected = upsample(y, factor, size)
        np.testing.assert_allclose(guided_upsample(y, factor, guide, kappa), expected, rtol=1e-10, atol=1e-11)
        rough = jnp.asarray(picture(seed, size, 3))
        np.testing.assert_allclose(guided_upsample(y, factor, rough, 1e9), expected, rtol=1e-10, atol=1e-11)


@given(shapes, seeds, kappas)
def test_no_value_leaves_the_range_of_the_cells_around_it(shape: tuple, seed: int, kappa: float) -> None:
    size, factor = shape
    y, guide = cells_of(seed, size, factor), picture(seed, size, 3)
    with jax.enable_x64(True):
        got = np.asarray(guided_upsample(jnp.asarray(y), factor, jnp.asarray(guide), kappa))
    padded = np.pad(y, [(1, 1), (1, 1), (0, 0)], mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
    low, high = (
        f(around, axis=(-2, -1)).repeat(factor, 0).repeat(factor, 1)[: size[0], : size[1]] for f in (np.min, np.max)
    )
    assert got.shape == low.shape and np.all(got >= low - 1e-12) and np.all(got <= high + 1e-12)


@given(shapes, seeds, kappas)
def test_constants_stay(shape: tuple, seed: int, kappa: float) -> None:
    size, factor = shape
    y = jnp.full(cells_of(0, size, factor).shape, 0.3)
    guide = jnp.asarray(picture(seed, size, 3), jnp.float32)
    np.testing.assert_allclose(
        guided_upsample(y, factor, guide, kappa), np.full((*size, 2), np.float32(0.3)), rtol=1e-6
    )


@pytest.mark.parametrize("factor", [4, 5])
def test_sharp_where_the_guide_has_an_edge(factor: int) -> None:
    """Four quarters of different value and colour whose borders are borders of cells: every pixel gets its own."""
    size = 4 * factor, 6 * factor
    quarter = (np.arange(size[0]) >= 2 * factor)[:, None] + 2 * (np.arange(size[1]) >= 2 * factor)
    truth = np.array([3.0, -1.0, 0.5, 8.0])[quarter][..., None]
    colours = np.array([[0.1, 0.5, 0.2], [0.9, 0.4, 0.1], [0.2, 0.8, 0.9], [0.6, 0.0, 0.5]])
    y, guide = downsample(jnp.asarray(truth, jnp.float32), factor), jnp.asarray(colours[quarter], jnp.float32)
    for norm in NORMS:
        np.testing.assert_allclose(guided_upsample(y, factor, guide, 0.005, norm=norm), truth, atol=5e-3)
    blurred = np.abs(np.asarray(upsample(y, factor, size)) - truth)
    assert blurred.max() > 1.0 and np.mean(blurred > 0.1) > 0.2


def test_an_edge_within_a_cell() -> None:
    """Its cell holds a mixture; on either side the pixels still come nearer to their own side than bilinearly."""
    truth = (np.arange(32) >= 18)[None, :, None] * np.ones((16, 1, 1), np.float32)
    y = downsample(jnp.asarray(truth), 4)
    sharp = np.abs(guided_upsample(y, 4, jnp.asarray(truth), 0.05) - truth)
    assert np.sum(sharp) < 0.75 * np.sum(np.abs(upsample(y, 4, (16, 32)) - truth))


@given(seeds, kappas)
def test_mirrored(seed: int, kappa: float) -> None:
    y, guide = cells_of(seed, (9, 12), 3), picture(seed, (9, 12), 3)
    with jax.enable_x64(True):
        plain = np.asarray(guided_upsample(jnp.asarray(y), 3, jnp.asarray(guide), kappa))
        for turn in (lambda a: a[::-1], lambda a: a[:, ::-1]):
            got = guided_upsample(jnp.asarray(turn(y)), 3, jnp.asarray(turn(guide)), kappa)
            np.testing.assert_allclose(got, turn(plain), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("norm", NORMS)
def test_gradients(norm: str) -> None:
    """With respect to the cells, the guide and κ; finite too under a guide without any edge."""
    size, factor = (5, 6), 3
    target = picture(9, size)

    def loss(y: jax.Array, guide: jax.Array, kappa: jax.Array) -> jax.Array:
        return jnp.sum((guided_upsample(y, factor, guide, kappa, norm=norm) - target) ** 2)

    y, guide = cells_of(0, size, factor), picture(1, size, 2)
    with jax.enable_x64(True):
        assert_gradients(loss, y, guide, 0.7)
        if norm == "mean_abs":
            flat = jax.jit(jax.grad(loss, argnums=(0, 1)))(jnp.asarray(y), jnp.ones((*size, 2)), 0.1)
            assert all(np.all(np.isfinite(leaf)) for leaf in flat)


def test_vmap() -> None:
    y, guide = (jnp.stack([jnp.asarray(a) for a in many]) for many in (
        [cells_of(k, (9, 12), 3) for k in range(3)], [picture(k, (9, 12), 3) for k in range(3)]
    ))  # fmt: skip
    batch = jax.vmap(lambda a, b: guided_upsample(a, 3, b, 0.4))(y, guide)
    for k in range(3):
        np.testing.assert_allclose(batch[k], guided_upsample(y[k], 3, guide[k], 0.4), atol=1e-6)


@pytest.mark.parametrize(("y_type", "guide_type"), [("float16", "float32"), ("float32", "float16")])
def test_mixed_precision(y_type: str, guide_type: str) -> None:
    """The result has the type of the cells, whatever the guide comes in; half precision does not lose a small κ."""
    y, guide = jnp.asarray(cells_of(0, (9, 12), 3), y_type), jnp.asarray(picture(1, (9, 12), 3), guide_type)
    got = guided_upsample(y, 3, guide, 0.5)
    assert got.dtype == y_type
    expected = literal(np.asarray(y, float), 3, np.asarray(guide, float), 0.5, "l2")
    np.testing.assert_allclose(np.asarray(got, float), expected, atol=2e-2)
    flat = guided_upsample(y, 3, jnp.ones_like(guide), 1e-4)
    np.testing.assert_allclose(np.asarray(flat, float), upsample(y, 3, (9, 12)), atol=5e-3)


@pytest.mark.parametrize("kappa", [1e-25, 1e25])
def test_no_kappa_is_too_small_or_large_for_flat_regions(kappa: float) -> None:
    y = jnp.asarray(cells_of(0, (9, 12), 3), jnp.float32)
    got = guided_upsample(y, 3, jnp.ones((9, 12, 2)), kappa)
    np.testing.assert_allclose(got, upsample(y, 3, (9, 12)), atol=1e-5)


def test_factor_one_changes_nothing() -> None:
    y = jnp.asarray(picture(0, (5, 7)))
    np.testing.assert_array_equal(guided_upsample(y, 1, jnp.asarray(picture(1, (5, 7), 3)), 0.1), y)


@pytest.mark.parametrize(
    ("factor", "size"),
    [(2, (10, 15)), (2, (8, 14)), (2, (11, 14)), (2, (5, 7)), (1, (5, 8)), (0, (5, 7)), (-2, (10, 14))],
)
def test_bad_factors_and_sizes_are_refused(factor: int, size: tuple[int, int]) -> None:
    message = rf"(?m)^factor: 5x7 cells times {factor} do not make a picture of {size[0]}x{size[1]}$"
    with pytest.raises(InputError, match=message):
        guided_upsample(jnp.zeros((5, 7, 1)), factor, jnp.zeros((*size, 3)), 0.1)
    assert guided_upsample(jnp.zeros((5, 7, 1)), 2, jnp.zeros((9, 13, 3)), 0.1).shape == (9, 13, 1)
