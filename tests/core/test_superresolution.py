"""Guided super-resolution: against loops and against Metzger's algorithm, and that it keeps to its source."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import superresolution as literal
from reference.differences import assert_gradients

from hyjax import InputError, Level, Schedule, cascade, conductance, diffuse, downsample, step_cycle, upsample
from hyjax.core.superresolution import adjust, coarsen, diffuse_adjusted, diffuse_adjusted_forward, super_resolve

pytestmark = pytest.mark.usefixtures("strict_ranks")

SIZES = [(1, 1), (3, 11), (16, 24), (13, 10)]  # few: every one is compiled anew
sizes = st.sampled_from(SIZES)
seeds = st.integers(0, 2**31)


def picture(seed: int, size: tuple[int, int], channels: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.5, 2.0, (*size, channels))


def random_mask(seed: int, size: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(seed).uniform(size=size) < 0.7


def problem(seed: int, size: tuple[int, int], factor: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Source, known cells and guide."""
    source, _ = coarsen(jnp.asarray(picture(seed, size, 2)), jnp.ones(size, bool), factor)
    return np.asarray(source), random_mask(seed + 1, source.shape[:2]), picture(seed + 2, size, 3)


def schedule_of(levels: list[tuple[int, int]], seed: int = 0) -> Schedule:
    rng = np.random.default_rng(seed)
    return Schedule(tuple(Level(f, rng.uniform(0.02, 0.249, n), rng.uniform(0.2, 1.0)) for f, n in levels))


CASES = [
    ((17, 13), 4, [(8, 2), (4, 2), (2, 3), (1, 2)], False),  # enters above the source's level; cells are cut off
    ((17, 13), 4, [(8, 2), (1, 2)], True),
    ((16, 24), 8, [(4, 3), (2, 0), (1, 1)], False),  # enters below the source's level
    ((12, 12), 6, [(6, 2), (3, 2)], True),  # never comes to full size
    ((9, 7), 2, [(4, 2), (2, 2)], False),  # never comes below the source's level
]


@pytest.mark.parametrize(("size", "factor", "levels", "started"), CASES)
def test_against_the_literal_form(
    size: tuple[int, int], factor: int, levels: list[tuple[int, int]], started: bool
) -> None:
    schedule = schedule_of(levels)
    start = picture(7, size, 2) if started else None
    with jax.enable_x64(True):
        source, known, guide = problem(0, size, factor)
        given_levels = [(level.factor, level.step_sizes, level.kappa) for level in schedule.levels]
        expected = literal.super_resolve(source, known, guide, given_levels, factor, start)
        got = super_resolve(source, known, jnp.asarray(guide), schedule, factor, start=start)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, expected, rtol=1e-11)
    single = [None if x is None else jnp.asarray(x, jnp.float32) for x in (source, guide, start)]
    got = super_resolve(single[0], known, single[1], schedule, factor, start=single[2])
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, rtol=2e-5)


@given(sizes, seeds, st.sampled_from([1, 4]))
def test_adjusting_makes_the_means_those_of_the_source(size: tuple[int, int], seed: int, factor: int) -> None:
    y = picture(seed, size, 2)
    with jax.enable_x64(True):
        source, known, _ = problem(seed + 1, size, factor)
        got = adjust(jnp.asarray(y), source, known, factor)
        np.testing.assert_allclose(got, literal.adjust(y, source, known, factor), rtol=1e-12)
        want = np.where(known[..., None], source, downsample(jnp.asarray(y), factor))
        np.testing.assert_allclose(downsample(got, factor), want, rtol=3e-8)
        np.testing.assert_allclose(adjust(got, source, known, factor), got, rtol=5e-8)  # once is enough


@given(sizes, seeds)
def test_the_result_keeps_to_its_source(size: tuple[int, int], seed: int) -> None:
    source, known, guide = problem(seed, size, 4)
    guide = jnp.asarray(guide, jnp.float32)
    got = super_resolve(source, known, guide, schedule_of([(8, 2), (2, 2)]), 4)
    np.testing.assert_allclose(np.asarray(downsample(got, 4))[known], source[known], rtol=1e-5)


@pytest.mark.parametrize("adjusted", [True, False])
def test_constants_stay(adjusted: bool) -> None:
    source, known = jnp.full((3, 4, 2), 0.7), jnp.asarray(random_mask(0, (3, 4)))
    guide = jnp.asarray(picture(0, (22, 29), 3), jnp.float32)
    got = super_resolve(source, known, guide, Schedule.preset("paper-50"), 8, adjusted=adjusted)
    np.testing.assert_allclose(got, 0.7, rtol=1e-6)


def test_scaling_the_source_scales_the_result() -> None:
    """So that it matters neither whether depth is in metres or millimetres nor what it is tinted with."""
    with jax.enable_x64(True):
        source, known, guide = problem(3, (16, 24), 4)
        scale = np.array([1000.0, 0.3])
        guide, schedule = jnp.asarray(guide), schedule_of([(4, 2), (1, 3)])
        once, scaled = (super_resolve(s, known, guide, schedule, 4) for s in (source, source * scale))
        np.testing.assert_allclose(scaled, np.asarray(once) * scale, rtol=1e-6)


def test_unadjusted_it_is_the_cascade() -> None:
    y, guide = (jnp.asarray(picture(k, (33, 20), 3), jnp.float32) for k in (0, 1))
    schedule = schedule_of([(8, 3), (4, 2), (2, 2)])
    source = downsample(y, 8)
    nothing = jnp.zeros(source.shape[:2], bool)
    want = cascade(y, guide, schedule)
    got = super_resolve(source, ~nothing, guide, schedule, 8, adjusted=False)
    np.testing.assert_allclose(got, want, rtol=1e-6)
    # and so it is where nothing is known
    np.testing.assert_allclose(super_resolve(source, nothing, guide, schedule, 8), want, rtol=1e-6)


def test_it_finds_a_border_that_the_guide_shows() -> None:
    """Two planes of depth whose border lies in the midst of cells: exact with a guide that knows it."""
    left = (np.arange(32) < 13) & np.ones((32, 1), bool)
    depth = jnp.asarray(np.where(left, 1.0, 3.0)[..., None], jnp.float32)
    source, known = coarsen(depth, jnp.ones((32, 32), bool), 8)
    naive = upsample(source, 8, (32, 32))
    got = super_resolve(source, known, depth, Schedule.uniform([(1, 1000)], kappa=1e-3), 8)
    assert np.abs(naive - depth).max() > 0.5
    np.testing.assert_allclose(got, depth, atol=0.01)


def test_metzger() -> None:
    """The published algorithm, from its paper and in torch, on the same features."""
    from reference import torch_metzger as metzger

    torch, factor, size = metzger.torch, 8, (48, 64)
    rng = np.random.default_rng(0)
    coarse = torch.tensor(rng.uniform(size=(1, 16, 6, 8)), dtype=torch.float32)  # smooth, with some noise
    features = metzger.bicubic(coarse, factor) + torch.tensor(rng.normal(0, 0.01, (1, 16, *size))).float()
    source = torch.tensor(rng.uniform(1.0, 4.0, (1, 1, 6, 8))).float()
    known = torch.tensor(random_mask(1, (1, 1, 6, 8)))
    want = metzger.super_resolve(source, known, features, factor=factor, steps=1000, kappa=0.03)
    schedule = Schedule.uniform([(1, 1000)], kappa=0.03, lam=0.24, norm="mean_abs")

    def channels_last(x: object) -> jax.Array:
        return jnp.moveaxis(jnp.asarray(x.numpy()[0]), 0, -1)

    start = channels_last(metzger.bicubic(source, factor))
    got = super_resolve(
        channels_last(source), known.numpy()[0, 0], channels_last(features), schedule, factor, start=start
    )
    np.testing.assert_allclose(got, channels_last(want), atol=1e-4)
    assert np.abs(got - start).max() > 0.1  # a thousand steps did something


def test_gradients() -> None:
    """With respect to source, start, guide, κ and every λ."""
    target = picture(9, (9, 10), 2)

    def loss(source: jax.Array, start: jax.Array, guide: jax.Array, kappa: jax.Array, lam: jax.Array) -> jax.Array:
        schedule = Schedule((Level(4, lam[:1], kappa), Level(2, lam[1:3], kappa), Level(1, lam[3:], kappa)))
        known = jnp.asarray(random_mask(0, (3, 3)))
        return jnp.sum((super_resolve(source, known, guide, schedule, 4, start=start) - target) ** 2)

    with jax.enable_x64(True):
        lam = np.array([0.1, 0.24, 0.2, 0.15, 0.05])
        assert_gradients(loss, picture(0, (3, 3), 2), picture(1, (9, 10), 2), picture(2, (9, 10), 3), 0.4, lam)


def test_the_two_ways_of_stepping_agree() -> None:
    """Fixed and traced counts; over a batch, and past the number from which gradients take turns in blocks."""
    source, known, guide = problem(0, (16, 24), 4)
    edges, y = conductance(jnp.asarray(guide), 0.4), jnp.asarray(picture(5, (16, 24), 2), jnp.float32)
    forward = jax.jit(lambda y, count: diffuse_adjusted_forward(y, edges, 0.2, count, source, known, 4))
    for count in (0, 3, 70):
        want = diffuse_adjusted(y, edges, np.full(count, 0.2), source, known, 4)
        np.testing.assert_allclose(forward(y, count), want, rtol=1e-5)
    batch = jnp.stack([y, 2 * y])
    for got, one in zip(jax.vmap(forward, (0, None))(batch, 3), batch, strict=True):
        np.testing.assert_allclose(got, forward(one, 3), rtol=1e-6)
    stepped = y
    for _ in range(3):
        stepped = adjust(diffuse(stepped, edges, np.array([0.2])), source, known, 4)
    np.testing.assert_allclose(stepped, forward(y, 3), rtol=1e-5)


def test_no_gradient_flows_through_the_steps_that_are_not_counted() -> None:
    source, known, guide = problem(0, (16, 24), 4)
    y = jnp.asarray(picture(5, (16, 24), 2), jnp.float32)

    @jax.jit
    def loss(guide: jax.Array, count: jax.Array) -> jax.Array:
        edges = conductance(guide, 0.4)
        settled = diffuse_adjusted_forward(y, edges, 0.2, count, source, known, 4)
        return jnp.sum(diffuse_adjusted(settled, edges, jnp.full(2, 0.2), source, known, 4) ** 2)

    guide = jnp.asarray(guide)
    edges = conductance(guide, 0.4)
    settled = diffuse_adjusted_forward(y, edges, 0.2, 5, source, known, 4)
    want = jax.grad(
        lambda g: jnp.sum(diffuse_adjusted(settled, conductance(g, 0.4), jnp.full(2, 0.2), source, known, 4) ** 2)
    )(guide)
    got = jax.grad(loss)(guide, jnp.asarray(5))
    assert np.any(np.asarray(got) != 0)
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6)


def test_gradient_memory_grows_like_the_root_of_the_steps() -> None:
    source, known, y = jnp.ones((8, 8, 3)), jnp.ones((8, 8), bool), jnp.ones((64, 64, 3))

    def temporary_bytes(steps: int) -> int:
        def loss(edges: tuple[jax.Array, jax.Array]) -> jax.Array:
            return diffuse_adjusted(y, edges, np.full(steps, 0.2, np.float32), source, known, 8).sum()

        lowered = jax.jit(jax.grad(loss)).lower(conductance(y, 0.1))
        return lowered.compile().memory_analysis().temp_size_in_bytes

    assert temporary_bytes(1600) < 5 * temporary_bytes(100)


@pytest.mark.parametrize("factor", [3, 11, 22, 44])
def test_a_cell_of_which_all_is_valid_is_known(factor: int) -> None:
    y = jnp.ones((factor, factor, 1))
    assert bool(coarsen(y, jnp.ones((factor, factor), bool), factor, least=1.0)[1].all())


def test_coarsen_takes_the_means_of_what_is_valid() -> None:
    y, valid = picture(0, (13, 10), 2), random_mask(1, (13, 10))
    valid[:4, :8] = False  # one cell without any valid pixel
    valid[0, 4] = True  # ... and its neighbour with one
    y[~valid] = 1e6
    source, known = coarsen(jnp.asarray(y), jnp.asarray(valid), 4, least=0.5)
    assert source.shape == (4, 3, 2) and known.shape == (4, 3)
    for i, j in np.ndindex(4, 3):
        cell = slice(4 * i, 4 * i + 4), slice(4 * j, 4 * j + 4)
        assert bool(known[i, j]) == (valid[cell].mean() >= 0.5)
        if valid[cell].any():
            np.testing.assert_allclose(source[i, j], y[cell][valid[cell]].mean(axis=0), rtol=1e-5)
    assert np.all(np.asarray(source) < 2.0)  # nothing of what is not valid, also where a cell has nothing else
    _, known = coarsen(jnp.asarray(y), jnp.asarray(valid), 4, least=0.0)
    assert not known[0, 0] and known[0, 1]


def test_bad_input_is_refused() -> None:
    source, known, guide = jnp.ones((2, 3, 1)), jnp.ones((2, 3), bool), jnp.zeros((8, 12, 3))
    fine = Schedule.uniform([(1, 1)])
    with pytest.raises(
        InputError, match=r"(?m)^source: shape \(2, 3, 1\) .* 8x12 at factor 8, which has 1x2 cells$"
    ):
        super_resolve(source, known, guide, fine, 8)
    with pytest.raises(InputError, match=r"(?m)^known: .* got bool of shape \(3, 2\); ch is 2 by source"):
        super_resolve(source, known.T, guide, fine, 4)
    with pytest.raises(InputError, match=r"(?m)^factor: .* in 1..1073741824, got 0$"):
        adjust(guide, source, known, 0)
    with pytest.raises(InputError, match=r"(?m)^super_resolve: schedule custom has a level of factor 3, which"):
        super_resolve(source, known, guide, Schedule.uniform([(3, 1)]), 4)
    with pytest.raises(InputError, match=r"(?m)^start: .* got float32 of shape \(8, 12, 3\); c is 1 by source"):
        super_resolve(source, known, guide, fine, 4, start=guide)
    edges = conductance(guide, 1.0)
    with pytest.raises(InputError, match=r"(?m)^lam: .*\(0, 1/4\)"):
        diffuse_adjusted(guide[..., :1], edges, np.array([0.3]), source, known, 4)
    with pytest.raises(InputError, match=r"(?m)^lam: .*\(0, 1/4\)"):
        diffuse_adjusted_forward(guide[..., :1], edges, 0.3, 1, source, known, 4)
    with pytest.raises(InputError, match=r"(?m)^edges: "):
        diffuse_adjusted(guide[..., :1], edges[::-1], np.array([0.2]), source, known, 4)


def test_schedules_beyond_the_paper_are_refused() -> None:
    source, known, guide = jnp.zeros((2, 2, 1)), jnp.ones((2, 2), bool), jnp.zeros((16, 16, 1))
    with pytest.raises(InputError, match=r"^super_resolve: schedule hyjax has a data term or guided upsampling"):
        super_resolve(source, known, guide, Schedule.preset("hyjax"), 8)
    cycles = Schedule((Level(8, step_cycle(10, 9.0), 0.1),))
    with pytest.raises(InputError, match=r"^lam: super-resolution takes no cycles"):
        super_resolve(source, known, guide, cycles, 8)
