"""Cycles of step sizes: the time they cover, the polynomial they stand for, and what rounding does to it."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import paper

from hyjax import InputError, diffuse, step_cycle
from hyjax.core.cycles import MOST_CYCLE_STEPS, growth, longest_time, shortest_cycle, stable_cycle

pytestmark = pytest.mark.usefixtures("strict_ranks")

counts = st.integers(1, MOST_CYCLE_STEPS)
shares = st.floats(0.01, 1.0)  # of the longest time
seeds = st.integers(0, 2**31)
Edges = tuple[np.ndarray, np.ndarray]


def rough_edges(seed: int, size: tuple[int, int]) -> Edges:
    """Conductances of all kinds, two thirds of them 0 or 1: the hardest for fine waves."""
    rng = np.random.default_rng(seed)
    h, w = size
    vertical, horizontal = rng.uniform(-1.0, 2.0, (h - 1, w)), rng.uniform(-1.0, 2.0, (h, w - 1))
    return np.clip(vertical, 0, 1).astype(np.float32), np.clip(horizontal, 0, 1).astype(np.float32)


def picture(seed: int, size: tuple[int, int]) -> np.ndarray:
    """Noise and a chessboard, the finest wave there is."""
    board = np.indices(size).sum(0)[..., None] % 2
    return (np.random.default_rng(seed).uniform(-1.0, 1.0, (*size, 2)) + board).astype(np.float32)


def run(y: np.ndarray, edges: Edges, sizes: np.ndarray, **options: float) -> np.ndarray:
    """`diffuse`; in float64 with `jax.enable_x64`."""
    return np.asarray(diffuse(jnp.asarray(y), tuple(map(jnp.asarray, edges)), sizes, **options))


def wide(*arrays: np.ndarray) -> list[np.ndarray]:
    return [a.astype(np.float64) for a in arrays]


# ---- the sizes ----


@given(counts, shares)
def test_the_sizes_are_the_published_ones(n: int, share: float) -> None:
    """τ_i = τ / (2 cos²(π (2i + 1) / (4n + 2))) of the paper, scaled to the time; their sum is the time."""
    time = share * longest_time(n)
    sizes = step_cycle(n, time)
    assert sizes.dtype == np.float32 and sizes.shape == (n,) and np.all(sizes > 0)
    np.testing.assert_allclose(sizes.sum(dtype=float), time, rtol=1e-6)
    published = [0.25 / (2 * np.cos(np.pi * (2 * i + 1) / (4 * n + 2)) ** 2) for i in range(n)]
    np.testing.assert_allclose(np.sort(sizes), share * np.array(published), rtol=1e-6)


def test_the_time_grows_with_the_square() -> None:
    """Single steps cover less than n/4; the paper's longest cycle covers 0.25 (n² + n) / 3."""
    assert [longest_time(n) for n in (1, 2, 5, 10, 100)] == pytest.approx([1 / 6, 1 / 2, 2.5, 110 / 12, 10100 / 12])
    assert longest_time(20) / longest_time(10) == pytest.approx(420 / 110)
    assert longest_time(50) > 16 * 0.25 * 50


@given(counts)
def test_the_shortest_cycle_is_the_shortest(n: int) -> None:
    assert shortest_cycle(longest_time(n)) == n
    assert shortest_cycle(1.0001 * longest_time(n)) == n + 1
    assert shortest_cycle(1e-9) == 1


@given(st.integers(1, MOST_CYCLE_STEPS - 1), st.floats(1.001, 30.0))
def test_too_long_a_time_names_the_steps_it_takes(n: int, times: float) -> None:
    time = min(times * longest_time(n), longest_time(MOST_CYCLE_STEPS))
    with pytest.raises(InputError) as refused:
        step_cycle(n, time)
    told = re.fullmatch(
        rf"cycle: {n} steps cover a .* of at most \S+ .*, not \S+; take at least (\d+) steps", str(refused.value)
    )
    assert told, refused.value
    least = int(told[1])
    assert least > n and step_cycle(least, time).size == least
    with pytest.raises(InputError, match=rf"^cycle: {least - 1} steps cover .* take at least {least} steps$"):
        step_cycle(least - 1, time)


def test_a_time_that_no_cycle_covers() -> None:
    with pytest.raises(InputError) as refused:
        step_cycle(MOST_CYCLE_STEPS, 1000.0)
    assert "110" not in str(refused.value)


@pytest.mark.parametrize("n", [0, -3, MOST_CYCLE_STEPS + 1])
def test_bad_numbers_of_steps_are_refused(n: int) -> None:
    with pytest.raises(InputError, match=rf"^cycle: need 1 to {MOST_CYCLE_STEPS} steps, got {n}$"):
        step_cycle(n, 1.0)


@pytest.mark.parametrize("time", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_times_are_refused(time: float) -> None:
    with pytest.raises(InputError, match=rf"^cycle: the diffusion time must be finite and > 0, got {time:g}$"):
        step_cycle(5, time)


# ---- how much they amplify ----


def literal_growth(sizes: np.ndarray, waves: int = 4001) -> tuple[float, float]:
    """Of any run of neighbouring steps and of all of them, one by one, at evenly spaced eigenvalues."""
    factors = np.abs(1.0 - np.asarray(sizes, float)[:, None] * np.linspace(0.0, 8.0, waves))
    n = len(factors)
    runs = [factors[a:b].prod(0).max() for a in range(n) for b in range(a + 1, n + 1)]
    return max(1.0, *runs), float(factors.prod(0).max())


def test_growth_in_numbers() -> None:
    """1 − 8 λ is the worst for a single step; a step that damps undoes one that amplifies, wherever they stand."""
    assert growth([0.2]) == pytest.approx((1.0, 1.0))
    assert growth([0.3]) == pytest.approx((1.4, 1.4))
    assert growth([0.3, 0.3]) == pytest.approx((1.96, 1.96))
    assert growth([0.125, 0.3]) == pytest.approx((1.4, 1.0))


@given(st.integers(2, 12), shares, seeds)
def test_growth_is_what_the_steps_do(n: int, share: float, seed: int) -> None:
    """Of a cycle in any order; it amplifies nothing as a whole."""
    sizes = np.random.default_rng(seed).permutation(step_cycle(n, share * longest_time(n)))
    worst, whole = growth(sizes)
    np.testing.assert_allclose((worst, whole), literal_growth(sizes), rtol=0.02)
    assert whole <= 1.0 + 1e-6 and worst >= whole


@pytest.mark.parametrize("n", [20, 54, MOST_CYCLE_STEPS])
def test_the_order_matters(n: int) -> None:
    sizes = step_cycle(n, longest_time(n))
    assert stable_cycle(sizes)
    for other in (np.sort(sizes), np.sort(sizes)[::-1]):
        assert growth(other)[0] > 1e5 * growth(sizes)[0] and not stable_cycle(other)


def test_every_cycle_is_stable_in_single_precision() -> None:
    """What `step_cycle` makes, `diffuse` takes."""
    for n in range(2, MOST_CYCLE_STEPS + 1):
        for share in (1.0, 0.93, 0.7, 0.4, 0.1):
            sizes = step_cycle(n, share * longest_time(n))
            if (n, share) != (97, 1.0):
                assert stable_cycle(sizes), f"{n} steps, {share} of the longest time: growth {growth(sizes)}"


def test_cycles_may_be_repeated() -> None:
    assert stable_cycle(np.tile(step_cycle(10, 9.0), 20))
    assert stable_cycle(step_cycle(97, longest_time(97)))


@pytest.mark.parametrize(
    "sizes",
    [
        [0.3],
        [0.25],
        [0.3, 0.3],
        [0.05, 0.5],
        [0.1, -0.3],
        [0.1, np.nan],
        [0.1, 0.0],
        [],
        [[0.1, 0.2]],
        [0.2] * 2049,
    ],
)
def test_what_is_no_stable_cycle(sizes: list) -> None:
    assert not stable_cycle(sizes)


# ---- what diffusion makes of them ----


def laplacian(edges: Edges) -> np.ndarray:
    """L = −div c ∇ as a matrix, from the literal step."""
    h, w = edges[0].shape[0] + 1, edges[1].shape[1] + 1
    basis = np.eye(h * w).reshape(h, w, h * w)
    return (basis - paper.diffuse_step(basis, edges, 1.0)).reshape(h * w, h * w)


@settings(max_examples=10)
@given(st.sampled_from([2, 7, 54]), shares, seeds)
def test_a_cycle_is_its_polynomial(n: int, share: float, seed: int) -> None:
    """Each eigenvector of the Laplacian is multiplied by ∏ (1 − λ_i μ)."""
    size, sizes = (4, 5), step_cycle(n, share * longest_time(n))
    edges, y = wide(*rough_edges(seed, size)), picture(seed, size).astype(float)
    eigenvalues, vectors = np.linalg.eigh(laplacian(edges))
    assert eigenvalues.min() > -1e-12 and eigenvalues.max() < 8
    multiplied = np.prod(1.0 - sizes.astype(float)[:, None] * eigenvalues, axis=0)
    expected = vectors * multiplied @ vectors.T @ y.reshape(-1, 2)
    with jax.enable_x64(True):
        np.testing.assert_allclose(run(y, edges, sizes).reshape(-1, 2), expected, atol=1e-9)


@settings(max_examples=10)
@given(shares, seeds)
def test_the_order_matters_to_rounding_alone(share: float, seed: int) -> None:
    sizes, edges, y = (
        step_cycle(7, share * longest_time(7)),
        wide(*rough_edges(seed, (4, 5))),
        picture(seed, (4, 5)),
    )
    shuffled = np.random.default_rng(seed).permutation(sizes)
    with jax.enable_x64(True):
        y = y.astype(np.float64)
        np.testing.assert_allclose(run(y, edges, shuffled), run(y, edges, sizes), atol=1e-11)


@pytest.mark.parametrize("n", [10, 54, MOST_CYCLE_STEPS])
def test_rounding_stays_small(n: int) -> None:
    """In float32, over rough conductances: near float64, no more energy than before, same mean."""
    for seed in range(3):
        size, sizes = (24, 32), step_cycle(n, longest_time(n))
        edges, y = rough_edges(seed, size), picture(seed, size)
        got = run(y, edges, sizes)
        assert got.dtype == np.float32
        with jax.enable_x64(True):
            exact = run(*wide(y), tuple(wide(*edges)), sizes)
        np.testing.assert_allclose(got, exact, atol=1e-4)
        np.testing.assert_allclose(got.mean((0, 1)), y.mean((0, 1)), atol=1e-5)
        assert np.sum(got**2) < np.sum(y**2)


def test_cycles_can_be_repeated() -> None:
    edges, y, sizes = rough_edges(0, (24, 32)), picture(0, (24, 32)), step_cycle(10, longest_time(10))
    np.testing.assert_allclose(run(y, edges, np.tile(sizes, 2)), run(run(y, edges, sizes), edges, sizes), atol=1e-5)


def test_a_cycle_gets_further_than_as_many_single_steps() -> None:
    """To the mean, over open ground."""
    size = (24, 32)
    y, edges = picture(0, size), (np.ones((23, 32), np.float32), np.ones((24, 31), np.float32))
    y[:, :16] += 1.0
    left_by_cycle = run(y, edges, step_cycle(54, longest_time(54))).std()
    left_by_steps = run(y, edges, np.full(54, 0.24, np.float32)).std()
    assert left_by_cycle < 0.2 * left_by_steps


@pytest.mark.parametrize("n", [10, 54])
def test_with_a_data_term_a_cycle_goes_to_where_single_steps_go(n: int) -> None:
    """Every step size leaves the same answer where it is, so a cycle never takes one away from it."""
    size, pull = (24, 32), 0.05
    edges, y = rough_edges(0, size), picture(0, size)
    system = pull * np.eye(24 * 32) + laplacian(edges)
    answer = np.linalg.solve(system, pull * y.reshape(-1, 2)).reshape(y.shape)
    got = run(y, edges, step_cycle(n, longest_time(n)), fidelity=pull)
    far, near = (np.sum((a - answer) ** 2) for a in (y, got))
    assert near < 0.1 * far
    if n == 54:
        assert near < 1e-6 * far


def test_what_diffuse_takes_for_a_cycle() -> None:
    """A step beyond 1/4 alone is refused; so is a cycle that half precision is too coarse for."""
    y, edges = jnp.ones((3, 4, 1)), (jnp.ones((2, 4)), jnp.ones((3, 3)))
    for lam in (0.25, 0.3):
        with pytest.raises(
            InputError, match=rf"^lam: a step size must lie inside \(0, 1/4\) .*cycle.* got {lam:g}$"
        ):
            diffuse(y, edges, np.array([lam]))
    long, short = (step_cycle(n, longest_time(n)) for n in (54, 5))
    assert long.max() > 0.25 and short.max() > 0.25
    half = y.astype(jnp.float16)
    with pytest.raises(InputError) as refused:
        diffuse(half, edges, long)
    assert str(refused.value) == (
        "lam: these 54 steps amplify rounding errors too much for float16; use shorter cycles, or float32"
    )
    np.testing.assert_allclose(diffuse(y, edges, long), y, rtol=1e-6)
    np.testing.assert_allclose(diffuse(half, edges, short), half, rtol=2e-2)
    with pytest.raises(InputError, match=r"^lam: a step size must lie inside"):
        diffuse(y, edges, np.sort(long))
