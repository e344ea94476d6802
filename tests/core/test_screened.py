"""The screened Poisson equation by cosine transforms, against a sparse solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import spsolve

from hyjax.core.screened import screened_poisson
from hyjax.core.stencil import divergence, gradient
from hyjax.util.errors import InputError

pytestmark = pytest.mark.usefixtures("strict_ranks")


def wanted(seed: int, height: int, width: int) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    return jnp.asarray(rng.normal(size=(height - 1, width))), jnp.asarray(rng.normal(size=(height, width - 1)))


def reference(edges: tuple[jax.Array, jax.Array], fidelity: float) -> np.ndarray:
    """By the normal equations, assembled from rows of differences."""
    height, width = edges[1].shape[0], edges[0].shape[1]

    def differences(count: int) -> sparse.spmatrix:
        return sparse.diags([-np.ones(count - 1), np.ones(count - 1)], [0, 1], shape=(count - 1, count))

    rows = sparse.vstack(
        [
            sparse.kron(differences(height), sparse.eye(width)),
            sparse.kron(sparse.eye(height), differences(width)),
        ]
    ).tocsc()
    values = np.concatenate([np.asarray(e).ravel() for e in edges])
    solved = spsolve((fidelity * sparse.eye(height * width) + rows.T @ rows).tocsc(), rows.T @ values)
    return solved.reshape(height, width)


@given(st.integers(0, 99), st.integers(2, 9), st.integers(2, 9), st.floats(1e-3, 10.0))
def test_it_is_the_sparse_solution(seed: int, height: int, width: int, fidelity: float) -> None:
    with jax.enable_x64(True):
        edges = wanted(seed, height, width)
        found = np.asarray(screened_poisson(edges, fidelity))
    np.testing.assert_allclose(found, reference(edges, fidelity), atol=1e-9)


def test_differences_of_a_field_give_it_back_but_for_its_mean() -> None:
    y = np.random.default_rng(0).normal(size=(3, 7, 5))
    with jax.enable_x64(True):
        found = np.asarray(screened_poisson(gradient(jnp.asarray(y)), 1e-6))
    np.testing.assert_allclose(found, y - y.mean(axis=(1, 2), keepdims=True), atol=1e-4)


def test_nothing_is_made_of_nothing_and_nothing_is_added() -> None:
    edges = wanted(1, 6, 8)
    assert abs(float(jnp.sum(screened_poisson(edges, 0.01)))) < 1e-3
    assert not screened_poisson((0 * edges[0], 0 * edges[1]), 0.01).any()


def test_gradients_are_those_of_the_adjoint() -> None:
    """The solve is symmetric: its transpose applied to w is the solve of w, read off along the edges."""
    with jax.enable_x64(True):
        edges, w = wanted(2, 5, 4), jnp.asarray(np.random.default_rng(3).normal(size=(5, 4)))
        slopes = jax.grad(lambda e: jnp.sum(w * screened_poisson(e, 0.3)))(edges)
        step = 1e-6
        moved = (edges[0].at[1, 2].add(step), edges[1])
        change = jnp.sum(w * (screened_poisson(moved, 0.3) - screened_poisson(edges, 0.3))) / step
    assert float(slopes[0][1, 2]) == pytest.approx(float(change), rel=1e-5)


def test_the_residual_vanishes_under_jit() -> None:
    edges = wanted(4, 33, 20)
    edges = (edges[0].astype(jnp.float32), edges[1].astype(jnp.float32))
    v = jax.jit(screened_poisson)(edges, 0.02)
    residual = 0.02 * v - divergence(gradient(v)) + divergence(edges)
    assert float(jnp.abs(residual).max()) < 1e-4


@pytest.mark.parametrize("fidelity", [0.0, -1.0, float("nan"), float("inf")])
def test_a_fidelity_that_is_none(fidelity: float) -> None:
    with pytest.raises(InputError, match="fidelity: must be above 0"):
        screened_poisson(wanted(0, 3, 3), fidelity)
