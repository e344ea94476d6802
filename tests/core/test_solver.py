"""The converged answer: against a dense solve, against long diffusion, and its implicit derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from hyjax import InputError, conductance, diffuse, solve
from hyjax.core import checks
from hyjax.core.solver import _apply


def problem(h: int, w: int, seed: int, dtype: type = np.float64) -> tuple:
    rng = np.random.default_rng(seed)
    edges = tuple(jnp.asarray(rng.uniform(0.0, 1.0, shape), dtype) for shape in ((h - 1, w), (h, w - 1)))
    return jnp.asarray(rng.uniform(-1.0, 1.0, (h, w, 2)), dtype), edges


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([(1, 1), (1, 6), (5, 4)]), st.floats(1e-3, 10.0), st.integers(0, 99))
def test_equals_a_dense_solve(size: tuple[int, int], fidelity: float, seed: int) -> None:
    h, w = size
    with jax.enable_x64(True):
        source, edges = problem(h, w, seed)
        basis = jnp.eye(h * w).reshape(h * w, h, w)
        matrix = _apply(basis, edges=edges, fidelity=jnp.asarray(fidelity)).reshape(h * w, h * w)
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
        expected = np.linalg.solve(matrix, fidelity * np.asarray(source).reshape(h * w, 2)).reshape(h, w, 2)
        np.testing.assert_allclose(solve(source, edges, fidelity, tolerance=1e-12), expected, atol=1e-8)


def test_is_where_diffusion_comes_to_rest() -> None:
    source, edges = problem(12, 9, 0, np.float32)
    long = diffuse(source, edges, np.full(3000, 0.24), fidelity=0.05)
    np.testing.assert_allclose(solve(source, edges, 0.05), long, atol=2e-5)


def test_starting_from_the_answer_changes_nothing_else() -> None:
    source, edges = problem(12, 9, 0, np.float32)
    cold = solve(source, edges, 0.01)
    np.testing.assert_allclose(solve(source, edges, 0.01, start=cold), cold, atol=2e-5)
    one = solve(source, edges, 0.01, start=cold, most_iterations=1)
    np.testing.assert_allclose(one, cold, atol=2e-5)


def test_implicit_derivatives_equal_finite_differences() -> None:
    with jax.enable_x64(True):
        rng = np.random.default_rng(0)
        source, guide = jnp.asarray(rng.random((5, 6, 1))), jnp.asarray(rng.random((5, 6, 3)))

        def loss(source: jax.Array, guide: jax.Array, log_kappa: jax.Array, log_alpha: jax.Array) -> jax.Array:
            edges = conductance(guide, jnp.exp(log_kappa))
            return jnp.sum(solve(source, edges, jnp.exp(log_alpha), tolerance=1e-14) ** 3)

        point = (source, guide, jnp.asarray(-1.0), jnp.asarray(-2.0))
        check_grads(loss, point, order=1, modes=["rev"], eps=1e-5, rtol=1e-5)


def test_small_slopes_do_not_drown() -> None:
    """In single precision, of light in hundreds of lux: the solution's mean is its source's."""
    source, edges = problem(32, 24, 1, np.float32)
    slope = jax.grad(lambda s: 1e-3 * jnp.mean(solve(s, edges, 0.005)))(200.0 * source + 300.0)
    np.testing.assert_allclose(slope, 1e-3 / source.size, rtol=1e-3)


def test_refusals() -> None:
    source, edges = problem(3, 4, 0, np.float32)
    with pytest.raises(InputError, match=r"^fidelity: must be finite and >= 0, got -1"):
        solve(source, edges, -1.0)
    with pytest.raises(InputError, match=r"^fidelity: must be > 0; without it everything flows"):
        solve(source, edges, 0.0)
    with pytest.raises(InputError, match=r"^edges"):
        solve(source[:2], edges, 0.1)
    for tolerance in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match=r"^tolerance: must be finite and >= 0, got"):
            solve(source, edges, 0.1, tolerance=tolerance)
    with pytest.raises(InputError, match=r"^most_iterations: must be at least 1, got 0"):
        solve(source, edges, 0.1, most_iterations=0)
    for beyond in ((edges[0] + 2.0, edges[1]), (edges[0], edges[1] - 2.0), (edges[0] * np.nan, edges[1])):
        with pytest.raises(InputError, match=r"^edges: conductances lie in \[0, 1\]"):
            solve(source, beyond, 0.1)


def test_edges_are_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their values would be waited for at each step."""
    source, edges = problem(3, 4, 0, np.float32)
    looks: list[object] = []
    monkeypatch.setattr(checks, "concrete", lambda value: looks.append(value) or np.asarray(value))
    for _ in range(3):
        checks.check_edges(source, edges)
    assert len(looks) == 2
