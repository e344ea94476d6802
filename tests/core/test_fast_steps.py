"""The fast forms of repeated steps against the plain one, and derivatives of the two together."""

from collections.abc import Callable

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies
from jax import export

from hyjax import conductance, diffuse
from hyjax.core.backends import select_backend, with_fast_values
from hyjax.core.diffusion import _steps
from hyjax.core.fast_steps import UNROLLED_STEPS, steps_in_place, steps_unrolled

pytestmark = pytest.mark.usefixtures("strict_ranks")
FORMS = pytest.mark.parametrize("form", [steps_in_place, steps_unrolled])


def example(seed: int, h: int, w: int, c: int, n: int) -> tuple:
    random = np.random.default_rng(seed)
    y, source = (jnp.asarray(random.random((h, w, c), np.float32)) for _ in range(2))
    edges = conductance(jnp.asarray(random.random((h, w, 3), np.float32)), 0.3)
    return y, edges, jnp.asarray(random.uniform(0.02, 0.24, n), jnp.float32), source


@hypothesis.settings(max_examples=15)
@hypothesis.given(
    seed=strategies.integers(0, 99),
    h=strategies.sampled_from([1, 2, 7, 40]),
    w=strategies.sampled_from([1, 3, 33]),
    c=strategies.sampled_from([1, 2, 5]),
    n=strategies.sampled_from([0, 1, 2, 3, 9]),
    fidelity=strategies.sampled_from([None, 0.0, 0.4]),
    with_source=strategies.booleans(),
    form=strategies.sampled_from([steps_in_place, steps_unrolled]),
)
def test_it_is_the_plain_form(
    seed: int,
    h: int,
    w: int,
    c: int,
    n: int,
    fidelity: float | None,
    with_source: bool,
    form: Callable[..., jax.Array],
) -> None:
    y, edges, sizes, source = example(seed, h, w, c, n)
    rest = None if fidelity is None else jnp.float32(fidelity), source if with_source else None
    expected, found = _steps(y, edges, sizes, *rest), form(y, edges, sizes, *rest)
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, atol=2e-6)
    np.testing.assert_array_equal(found if n == 0 else y, y)


@FORMS
def test_whatever_stands_on_the_rim_counts_nothing(form: Callable[..., jax.Array]) -> None:
    y, edges, sizes, _ = example(0, 6, 5, 1, 4)
    flat = jnp.full_like(y, 1e6)
    np.testing.assert_array_equal(form(flat, edges, sizes, None, None), flat)


@FORMS
@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_precision_stays(dtype: jnp.dtype, form: Callable[..., jax.Array]) -> None:
    y, edges, sizes, _ = example(1, 9, 8, 2, 5)
    found = form(y.astype(dtype), edges, sizes.astype(dtype), None, None)
    assert found.dtype == dtype
    np.testing.assert_allclose(found.astype(jnp.float32), _steps(y, edges, sizes, None, None), atol=0.02)


def test_derivatives_are_those_of_the_plain_form() -> None:
    """To the last bit: the fast form has no part in them."""
    y, edges, sizes, source = example(2, 6, 7, 2, 5)
    arguments = y, edges, sizes, jnp.float32(0.2), source
    fast = with_fast_values(_steps, steps_in_place)
    slopes = [
        jax.grad(lambda *a, form=form: jnp.sum(form(*a) ** 2), range(5))(*arguments) for form in (_steps, fast)
    ]
    jax.tree.map(np.testing.assert_array_equal, *slopes)
    assert all(any(np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(slope)) for slope in slopes[1])


def test_second_derivatives_batches_and_forward_mode() -> None:
    y, edges, sizes, _ = example(3, 4, 5, 1, 3)
    fast = with_fast_values(_steps, steps_in_place)

    def energy(form, sizes):
        return jnp.sum(form(y, edges, sizes, None, None) ** 2)

    np.testing.assert_allclose(
        jax.hessian(lambda s: energy(fast, s))(sizes), jax.hessian(lambda s: energy(_steps, s))(sizes), rtol=1e-5
    )
    batch = jnp.stack([y, 2 * y])
    found = jax.vmap(lambda y: fast(y, edges, sizes, None, None))(batch)
    np.testing.assert_allclose(found[1], 2 * found[0], rtol=1e-5)
    _, slope = jax.jvp(lambda y: fast(y, edges, sizes, None, None), (y,), (y,))
    np.testing.assert_allclose(slope, found[0], rtol=1e-5)  # linear in y


def test_values_come_from_the_fast_form() -> None:
    """Else the tests above compare the plain form with itself."""
    function = with_fast_values(lambda x: x**2, lambda x: x**2 + 1.0)
    assert float(function(3.0)) == 10.0
    assert float(jax.grad(function)(3.0)) == 6.0


@pytest.mark.parametrize(
    ("count", "size", "marker"), [(1, 500, True), (1, 600, False), (2, 500, True), (64, 80, False)]
)
def test_what_is_worth_sharing_is_shared(
    monkeypatch: pytest.MonkeyPatch, count: int, size: int, marker: bool
) -> None:
    y, edges, sizes, _ = example(4, size, size, 1, 4)
    monkeypatch.setattr("hyjax.core.backends.cores", lambda: count)
    text = jax.jit(select_backend(_steps)).lower(y, edges, sizes, None, None).as_text()
    assert ("dynamic_update_slice" in text) == marker


def test_diffuse_takes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    y, edges, sizes, _ = example(4, 8, 8, 1, 4)
    monkeypatch.setattr("hyjax.core.backends.cores", lambda: 1)
    jax.clear_caches()  # the form is chosen while tracing
    assert "dynamic_update_slice" in jax.jit(diffuse).lower(y, edges, sizes).as_text()
    np.testing.assert_allclose(diffuse(y, edges, sizes), _steps(y, edges, sizes, None, None), atol=2e-6)


@pytest.mark.parametrize("there", [True, False])
def test_a_gpu_takes_steps_written_out(monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    """As far as that can be seen without one: in the program for CUDA a turn of the loop has several steps."""
    y, edges, sizes, _ = example(6, 20, 30, 2, 2 * UNROLLED_STEPS)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu" if there else "cpu")
    text = export.export(jax.jit(select_backend(_steps)), platforms=["cuda"])(
        y, edges, sizes, None, None
    ).mlir_module()
    assert (text.count("stablehlo.while"), text.count("tensor<2x22x32xf32>") > UNROLLED_STEPS) == (1, there)


@pytest.mark.slow
@FORMS
def test_large_pictures_and_long_runs(form: Callable[..., jax.Array]) -> None:
    y, edges, sizes, source = example(5, 140, 150, 2, 3 * UNROLLED_STEPS + 1)
    rest = jnp.float32(0.3), source
    np.testing.assert_allclose(form(y, edges, sizes, *rest), _steps(y, edges, sizes, *rest), atol=2e-6)
