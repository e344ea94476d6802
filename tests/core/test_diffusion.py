"""Eq. 2 and 3 against the literal loops, and the properties that make it diffusion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import paper
from reference.differences import assert_gradients

from hyjax import InputError, conductance, diffuse, diffuse_step
from hyjax.core.diffusion import edge_stopping, guide_distance
from hyjax.core.stencil import divergence, gradient

pytestmark = pytest.mark.usefixtures("strict_ranks")

SIZES = [(1, 1), (1, 6), (5, 1), (3, 7), (9, 8)]  # few: every one is compiled anew
sizes = st.sampled_from(SIZES)
seeds = st.integers(0, 2**31)
norms = st.sampled_from(["l2", "mean_abs"])


def picture(seed: int, size: tuple[int, int], channels: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 2.0, (*size, channels))


def random_edges(seed: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Conductances in [0, 1], about a quarter of them zero."""
    rng = np.random.default_rng(seed)
    h, w = size
    vertical, horizontal = rng.uniform(-0.3, 1.0, (h - 1, w)), rng.uniform(-0.3, 1.0, (h, w - 1))
    return np.maximum(vertical, 0.0), np.maximum(horizontal, 0.0)


@given(sizes, seeds, norms, st.floats(0.01, 10.0))
def test_conductance_is_equation_3(size: tuple[int, int], seed: int, norm: str, kappa: float) -> None:
    channels = 1 + size[1] % 5
    guide = picture(seed, size, channels)
    expected = paper.conductance(guide, kappa, norm)
    with jax.enable_x64(True):
        for got, want in zip(conductance(jnp.asarray(guide), kappa, norm=norm), expected, strict=True):
            assert got.dtype == np.float64
            np.testing.assert_allclose(got, want, rtol=1e-12)
    for got, want in zip(conductance(jnp.asarray(guide, jnp.float32), kappa, norm=norm), expected, strict=True):
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, want, rtol=2e-4)


def test_conductance_in_numbers() -> None:
    """κ = 0.5 against a jump of (0.3, 0.4): one half by the norm, 0.25/(0.25 + 0.35²) by the mean of |Δg|."""
    guide = jnp.array([[[0.0, 0.0], [0.3, -0.4]]])
    np.testing.assert_allclose(conductance(guide, 0.5)[1], [[0.5]], rtol=1e-6)
    np.testing.assert_allclose(conductance(guide, 0.5, norm="mean_abs")[1], [[0.25 / (0.25 + 0.35**2)]], rtol=1e-6)


@given(sizes, seeds, st.sampled_from([0, 5]))
def test_diffuse_is_equation_2(size: tuple[int, int], seed: int, steps: int) -> None:
    channels = 1 + size[1] % 7
    y, edges = picture(seed, size, channels), random_edges(seed + 1, size)
    lam = np.random.default_rng(seed + 2).uniform(0.01, 0.249, steps)
    expected = paper.diffuse(y, edges, lam)
    with jax.enable_x64(True):
        got = diffuse(jnp.asarray(y), tuple(map(jnp.asarray, edges)), lam)
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13)
    edges32 = tuple(jnp.asarray(e, jnp.float32) for e in edges)
    got = diffuse(jnp.asarray(y, jnp.float32), edges32, lam.astype(np.float32))
    np.testing.assert_allclose(got, expected, atol=2e-6)


@given(sizes, seeds)
def test_one_step_is_diffuse_once(size: tuple[int, int], seed: int) -> None:
    y = jnp.asarray(picture(seed, size, 2), jnp.float32)
    edges = tuple(jnp.asarray(e, jnp.float32) for e in random_edges(seed, size))
    np.testing.assert_array_equal(diffuse_step(y, edges, 0.2), diffuse(y, edges, jnp.array([0.2])))


@given(sizes, seeds)
def test_divergence_is_the_negative_adjoint_of_gradient(size: tuple[int, int], seed: int) -> None:
    """⟨∇y, f⟩ = −⟨y, div f⟩ for every y and f: nothing is made or lost, least of all at the border."""
    with jax.enable_x64(True):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=(2, *size))
        flux = rng.normal(size=(2, size[0] - 1, size[1])), rng.normal(size=(2, size[0], size[1] - 1))
        left = sum(np.sum(np.asarray(g) * f) for g, f in zip(jax.jit(gradient)(y), flux, strict=True))
        right = -np.sum(np.asarray(y) * jax.jit(divergence)(flux))
        np.testing.assert_allclose(left, right, rtol=1e-11, atol=1e-12)


def test_gradient_points_down_and_right() -> None:
    y = jnp.arange(12.0).reshape(3, 4)
    vertical, horizontal = gradient(y)
    np.testing.assert_array_equal(vertical, np.full((2, 4), 4.0))
    np.testing.assert_array_equal(horizontal, np.full((3, 3), 1.0))


@given(sizes, seeds)
def test_maximum_principle_and_mean(size: tuple[int, int], seed: int) -> None:
    """Right up to the stability limit no value leaves the range it started from, and the mean stays."""
    with jax.enable_x64(True):
        y = picture(seed, size, 2)
        edges = tuple(map(jnp.asarray, random_edges(seed, size)))
        for steps in (1, 5):
            out = np.asarray(diffuse(jnp.asarray(y), edges, np.full(steps, 0.2499999)))
            low, high = np.min(y, (0, 1)) - 1e-12, np.max(y, (0, 1)) + 1e-12
            assert np.all(out >= low) and np.all(out <= high)
            np.testing.assert_allclose(np.mean(out, (0, 1)), np.mean(y, (0, 1)), atol=1e-13)


@given(sizes, seeds, norms)
def test_flip_and_transpose_symmetry(size: tuple[int, int], seed: int, norm: str) -> None:
    y, guide = picture(seed, size, 2), picture(seed + 1, size, 3)
    lam = np.full(4, 0.2)

    def run(y: np.ndarray, guide: np.ndarray) -> np.ndarray:
        return np.asarray(diffuse(jnp.asarray(y), conductance(jnp.asarray(guide), 0.4, norm=norm), lam))

    with jax.enable_x64(True):
        plain = run(y, guide)
        for turn in (lambda a: a[::-1], lambda a: a[:, ::-1], lambda a: a.transpose(1, 0, 2)):
            np.testing.assert_allclose(run(turn(y), turn(guide)), turn(plain), rtol=1e-12, atol=1e-14)


def test_constants_are_fixed_points() -> None:
    y = jnp.full((7, 6, 3), 0.3)
    edges = tuple(jnp.asarray(e, jnp.float32) for e in random_edges(0, (7, 6)))
    np.testing.assert_array_equal(diffuse(y, edges, np.full(30, 0.24)), y)


@pytest.mark.parametrize("mode", [(1, 0), (0, 2), (3, 1), (16, 23)])
def test_cosine_decays_as_the_heat_equation_says(mode: tuple[int, int]) -> None:
    """For κ → ∞ the cosines cos(πm(i + ½)/H) cos(πn(j + ½)/W) are eigenvectors of the Neumann grid.

    Their eigenvalue is 4 sin²(πm/2H) + 4 sin²(πn/2W), which for long waves is the heat equation's decay
    exp(−π²(m²/H² + n²/W²) t) with t = steps · λ.
    """
    h, w, steps, lam = 17, 24, 50, 0.2
    with jax.enable_x64(True):
        rows = np.cos(np.pi * mode[0] * (np.arange(h) + 0.5) / h)
        columns = np.cos(np.pi * mode[1] * (np.arange(w) + 0.5) / w)
        y = jnp.asarray(np.outer(rows, columns)[..., None])
        edges = conductance(jnp.asarray(picture(0, (h, w), 3)), 1e9)
        eigenvalue = sum(4 * np.sin(np.pi * m / (2 * s)) ** 2 for m, s in zip(mode, (h, w), strict=True))
        decay = (1 - lam * eigenvalue) ** steps
        got = np.asarray(diffuse(y, edges, np.full(steps, lam)))
        np.testing.assert_allclose(got, decay * np.asarray(y), rtol=1e-9, atol=1e-12)
        if max(mode) <= 2:
            continuous = np.exp(-(np.pi**2) * ((mode[0] / h) ** 2 + (mode[1] / w) ** 2) * steps * lam)
            np.testing.assert_allclose(decay, continuous, rtol=0.02)
            np.testing.assert_allclose(np.sum(got * y) / np.sum(np.asarray(y) ** 2), continuous, rtol=0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_line_of_zero_conductance_blocks_all_flow(axis: int) -> None:
    edges = [np.ones((8, 9), np.float32), np.ones((9, 8), np.float32)]
    edges[axis][(slice(None), slice(3, 4))[:: 1 if axis else -1]] = 0.0
    y = np.random.default_rng(0).uniform(size=(9, 9, 1)).astype(np.float32)
    side = (slice(0, 4), slice(None)) if axis == 0 else (slice(None), slice(0, 4))
    changed = y.copy()
    changed[side] = 100.0
    other = np.ones((9, 9), bool)
    other[side] = False
    edges = tuple(map(jnp.asarray, edges))
    lam = np.full(200, 0.24)
    before, after = diffuse(jnp.asarray(y), edges, lam), diffuse(jnp.asarray(changed), edges, lam)
    np.testing.assert_array_equal(np.asarray(before)[other], np.asarray(after)[other])
    np.testing.assert_array_equal(np.asarray(after)[~other], 100.0)
    # and up to the line it does flow: each side has come to its own mean
    np.testing.assert_allclose(np.asarray(before)[other], y[other].mean(), atol=2e-3)


def test_no_step_changes_nothing() -> None:
    y = jnp.asarray(picture(0, (4, 5), 1), jnp.float32)
    edges = tuple(jnp.asarray(e, jnp.float32) for e in random_edges(0, (4, 5)))
    np.testing.assert_array_equal(diffuse(y, edges, np.zeros(0, np.float32)), y)


@pytest.mark.parametrize("norm", ["l2", "mean_abs"])
def test_gradients(norm: str) -> None:
    """With respect to the picture, the guide, κ and every λ; also under vmap."""
    target = picture(9, (5, 4), 2)

    def loss(y: jax.Array, guide: jax.Array, kappa: jax.Array, lam: jax.Array) -> jax.Array:
        return jnp.sum((diffuse(y, conductance(guide, kappa, norm=norm), lam) - target) ** 2)

    with jax.enable_x64(True):
        assert_gradients(loss, picture(0, (5, 4), 2), picture(1, (5, 4), 3), 0.4, np.array([0.1, 0.24, 0.2]))
        batch = jnp.asarray(np.stack([picture(k, (5, 4), 2) for k in range(3)]))
        edges = conductance(jnp.asarray(picture(1, (5, 4), 3)), 0.4, norm=norm)
        lam = np.array([0.1, 0.2])
        got = jax.vmap(lambda y: diffuse(y, edges, lam))(batch)
        for one, y in zip(got, batch, strict=True):
            np.testing.assert_allclose(one, diffuse(y, edges, lam), rtol=1e-12)


@pytest.mark.parametrize("channels", [1, 3, 6, 64])
def test_slopes_of_the_distance(channels: int) -> None:
    """They are written by hand; forwards and backwards, against those of the sum as it stands in Eq. 3."""

    def plainly(guide: jax.Array) -> tuple[jax.Array, jax.Array]:
        return ((guide[1:] - guide[:-1]) ** 2).sum(-1), ((guide[:, 1:] - guide[:, :-1]) ** 2).sum(-1)

    with jax.enable_x64(True):
        guide, change = (jnp.asarray(picture(seed, (5, 4), channels)) for seed in (0, 1))
        expected, pull_back = jax.vjp(plainly, guide)
        got, pull_back_ours = jax.vjp(guide_distance, guide)
        weights = jax.tree.map(jnp.cos, expected)
        moved = [jax.jvp(distance, (guide,), (change,))[1] for distance in (guide_distance, plainly)]
        for ours, theirs in [(got, expected), (pull_back_ours(weights), pull_back(weights)), moved]:
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12), ours, theirs)


def test_flat_guides_have_finite_gradients() -> None:
    """No square root in the norm: a guide without any edge does not make NaN."""
    guide = jnp.ones((4, 5, 3))
    for norm in ("l2", "mean_abs"):
        grad = jax.grad(lambda g, norm=norm: jnp.sum(conductance(g, 0.1, norm=norm)[0]))(guide)
        assert np.all(np.isfinite(grad))


# ---- the data term ----

pulls = st.floats(0.0, 20.0)
few_sizes = st.sampled_from([(1, 6), (9, 8)])


@given(few_sizes, seeds, pulls)
def test_the_data_term_is_implicit(size: tuple[int, int], seed: int, pull: float) -> None:
    """(1 + λ α) y' = y + λ div(c ∇y) + λ α source, step by step."""
    y, source, edges = picture(seed, size, 2), picture(seed + 1, size, 2), random_edges(seed, size)
    lam = np.random.default_rng(seed).uniform(0.01, 0.249, 3)
    expected = y
    for step in lam:
        moved = paper.diffuse_step(expected, edges, step)
        expected = (moved + step * pull * source) / (1 + step * pull)
    with jax.enable_x64(True):
        held = jnp.asarray(source)
        got = diffuse(jnp.asarray(y), tuple(map(jnp.asarray, edges)), lam, fidelity=pull, source=held)
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13)


@given(few_sizes, seeds, pulls)
def test_with_a_data_term_range_and_mean_are_kept(size: tuple[int, int], seed: int, pull: float) -> None:
    """Nothing leaves the range of picture and source; held on to itself a picture keeps its mean, held on to
    another the mean goes over to that one's, by 1/(1 + λ α) a step."""
    with jax.enable_x64(True):
        edges, lam = tuple(map(jnp.asarray, random_edges(seed, size))), np.full(3, 0.2499999)
        y, source = (jnp.asarray(picture(seed + k, size, 2)) for k in (0, 1))
        itself = np.asarray(diffuse(y, edges, lam, fidelity=pull))
        other = np.asarray(diffuse(y, edges, lam, fidelity=pull, source=source))
        both = np.concatenate([y, source])
        for out, values in ((itself, np.asarray(y)), (other, both)):
            assert np.all(out >= np.min(values, (0, 1)) - 1e-12) and np.all(out <= np.max(values, (0, 1)) + 1e-12)
        mean, goal = (np.mean(a, (0, 1)) for a in (y, source))
        np.testing.assert_allclose(np.mean(itself, (0, 1)), mean, atol=1e-13)
        left = (1 + 0.2499999 * pull) ** -3
        np.testing.assert_allclose(np.mean(other, (0, 1)), goal + left * (mean - goal), atol=1e-13)


@given(seeds)
def test_the_ends_of_the_data_term(seed: int) -> None:
    """α = 0 is none; a huge α gives the source; a constant that holds on to itself stays."""
    y, source = (jnp.asarray(picture(seed + k, (9, 8), 2), jnp.float32) for k in (0, 1))
    edges = tuple(jnp.asarray(e, jnp.float32) for e in random_edges(seed, (9, 8)))
    lam = np.full(3, 0.2, np.float32)
    np.testing.assert_allclose(diffuse(y, edges, lam, fidelity=0.0), diffuse(y, edges, lam), atol=1e-6)
    np.testing.assert_allclose(diffuse(y, edges, lam, fidelity=1e7, source=source), source, atol=1e-5)
    np.testing.assert_array_equal(
        diffuse(y, edges, lam, fidelity=0.5), diffuse(y, edges, lam, fidelity=0.5, source=y)
    )
    flat = jnp.full_like(y, 0.3)
    np.testing.assert_allclose(diffuse(flat, edges, lam, fidelity=0.7), flat, rtol=1e-6)


def test_gradients_of_the_data_term() -> None:
    """With respect to the picture, the source, the guide, every λ and α."""
    target = picture(9, (5, 4), 2)

    def loss(y: jax.Array, source: jax.Array, guide: jax.Array, lam: jax.Array, pull: jax.Array) -> jax.Array:
        held = diffuse(y, conductance(guide, 0.4), lam, fidelity=pull, source=source)
        return jnp.sum((held - target) ** 2)

    with jax.enable_x64(True):
        pictures = (picture(k, (5, 4), channels) for k, channels in ((0, 2), (1, 2), (2, 3)))
        assert_gradients(loss, *pictures, np.array([0.1, 0.24, 0.2]), 0.7)


@pytest.mark.parametrize("pull", [-1e-3, -1.0, float("nan"), float("inf")])
def test_bad_fidelities_are_refused(pull: float) -> None:
    y = jnp.zeros((3, 4, 1))
    with pytest.raises(InputError, match=rf"^fidelity: must be finite and >= 0, got {pull}"):
        diffuse(y, conductance(y, 1.0), np.array([0.1]), fidelity=pull)
    with pytest.raises(InputError, match=r"^fidelity: must be at most 1e\+15 and >= 0, got 3e\+38"):
        diffuse(y, conductance(y, 1.0), np.array([0.1]), fidelity=3e38)  # whose sum with a conductance is infinite


def test_a_source_of_another_size_is_refused() -> None:
    y = jnp.zeros((3, 4, 1))
    with pytest.raises(InputError, match=r"source"):
        diffuse(y, conductance(y, 1.0), np.array([0.1]), fidelity=1.0, source=jnp.ones((1, 4, 1)))


def test_small_kappa_in_half_precision() -> None:
    vertical, _ = edge_stopping(guide_distance(jnp.array([[[0.0]], [[0.01]]], jnp.float16)), 0.01)
    np.testing.assert_allclose(np.asarray(vertical, np.float32), 0.5, rtol=0.01)


@pytest.mark.parametrize(("y_type", "guide_type"), [("float16", "float32"), ("float32", "float16")])
def test_mixed_precision(y_type: str, guide_type: str) -> None:
    """The result has the type of what is diffused, whatever the guide comes in."""
    y, guide = jnp.asarray(picture(0, (5, 4), 2), y_type), jnp.asarray(picture(1, (5, 4), 3), guide_type)
    got = diffuse(y, conductance(guide, 0.5), np.array([0.1, 0.2]))
    assert got.dtype == y_type
    want = paper.diffuse(np.asarray(y), paper.conductance(np.asarray(guide), 0.5), np.array([0.1, 0.2]))
    np.testing.assert_allclose(np.asarray(got, np.float64), want, atol=5e-3)


@pytest.mark.parametrize("kappa", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_kappa_is_refused(kappa: float) -> None:
    with pytest.raises(InputError, match=rf"^kappa: must be finite and > 0, got {kappa}"):
        conductance(jnp.zeros((3, 3, 1)), kappa)


@pytest.mark.parametrize("lam", [0.0, -0.1, 0.9, float("nan"), float("inf")])
def test_bad_step_sizes_are_refused(lam: float) -> None:
    y, edges = jnp.zeros((3, 3, 1)), conductance(jnp.zeros((3, 3, 1)), 1.0)
    with pytest.raises(InputError, match=rf"^lam: .*\(0, 1/4\).*got {lam:g}$"):
        diffuse(y, edges, np.array([0.1, lam]))
    with pytest.raises(InputError, match=r"^lam: .*\(0, 1/4\)"):
        diffuse_step(y, edges, lam)


def test_foreign_edges_and_guides_are_refused() -> None:
    y, edges = jnp.zeros((3, 4, 1)), conductance(jnp.zeros((4, 3, 1)), 1.0)
    with pytest.raises(InputError, match=r"^edges\[0\]: .* got float32 of shape \(3, 3\); w is 4 by y$"):
        diffuse(y, edges, np.array([0.1]))
    with pytest.raises(InputError, match=r"^edges"):
        diffuse_step(y, edges[::-1], 0.1)
    with pytest.raises(InputError, match=r"(?m)^guide: .* of shape h x w x f, got float32 of shape \(3, 4\)$"):
        conductance(jnp.zeros((3, 4)), 1.0)
    with pytest.raises(InputError, match=r"(?m)^norm: 'l1' is unknown .*; use one of l2, mean_abs$"):
        conductance(jnp.zeros((3, 4, 1)), 1.0, norm="l1")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"need H x W x F features, got shape \(3, 4, 0\)"):
        guide_distance(jnp.zeros((3, 4, 0)))


def test_no_kappa_is_too_small_for_flat_regions() -> None:
    for dtype, kappa in ((jnp.float16, 1e-3), (jnp.float32, 1e-25)):
        for edge in conductance(jnp.ones((3, 4, 2), dtype), kappa):
            assert edge.dtype == dtype and np.all(np.asarray(edge) == 1)


def test_gradient_memory_of_a_long_run_grows_like_its_root() -> None:
    y = jnp.ones((64, 64, 3))

    def temporary_bytes(steps: int) -> int:
        loss = jax.grad(lambda edges: diffuse(y, edges, np.full(steps, 0.2, np.float32)).sum())
        return jax.jit(loss).lower(conductance(y, 0.1)).compile().memory_analysis().temp_size_in_bytes

    assert temporary_bytes(1600) < 4 * temporary_bytes(100)
