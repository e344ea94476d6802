"""A value that is not finite, in a guide or a frame, stays where it is."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyjax

H, W = 48, 64
RNG = np.random.default_rng(1)
GUIDE = RNG.random((H, W, 3)).astype(np.float32) * 0.1
LIGHT = RNG.random((H, W, 1)).astype(np.float32)
KNOWN = RNG.random((H, W, 1)) > 0.2
SCHEDULES = {
    "guide": hyjax.Schedule.uniform([(4, 2), (2, 2)], pooling="guide", upsampling="guide", fidelity=0.1),
    "edges": hyjax.Schedule.uniform([(4, 2), (2, 2)]),
}
REACH = 24
"""Pixels: a cell of 4 on either side, two steps between cells of 4, two between cells of 2, and interpolation."""
bad_values = st.sampled_from([np.nan, np.inf, -np.inf, np.float32(3e38)])
rows, columns = st.integers(0, H - 1), st.integers(0, W - 1)


def away(row: int, column: int, reach: int) -> np.ndarray:
    i, j = np.mgrid[:H, :W]
    return np.maximum(abs(i - row), abs(j - column)) > reach


@pytest.mark.parametrize("pooling", SCHEDULES)
@given(bad_values, rows, columns, st.integers(0, 2))
def test_of_a_guide(pooling: str, bad: float, row: int, column: int, channel: int) -> None:
    """Beyond what a value can reach nothing changes; nowhere does the result leave the range of the filter."""
    guide = GUIDE.copy()
    guide[row, column, channel] = bad
    usual, result = (np.asarray(hyjax.cascade_known(LIGHT, KNOWN, g, SCHEDULES[pooling])) for g in (GUIDE, guide))
    assert np.isfinite(result).all()
    assert result.min() >= -1e-5 and result.max() <= 1.0 + 1e-5
    far = away(row, column, REACH)
    np.testing.assert_allclose(result[far], usual[far], atol=1e-6)


@pytest.mark.slow
@given(bad_values, rows, columns)
@settings(max_examples=5)
def test_of_a_frame(bad: float, row: int, column: int) -> None:
    """The pixel alone is black, under another guide than the frame."""
    frame = GUIDE.copy()
    frame[row, column] = bad
    hit = jnp.ones((H, W), bool)
    normal = jnp.zeros((H, W, 3)).at[..., 2].set(1.0)
    gbuffer = hyjax.GBuffer(jnp.asarray(GUIDE), normal, jnp.ones((H, W)), hit)
    lights = [hyjax.AmbientLight(np.float32(100.0), np.ones(3, np.float32))]
    pictures = []
    for display in (GUIDE, frame):
        view = hyjax.View.of(jnp.asarray(display), gbuffer)
        schedule = SCHEDULES["guide"]
        relit = hyjax.relight(view, view.shade(lights), GUIDE, schedule, shadow_schedule=schedule)
        pictures.append(np.asarray(relit.image))
    usual, result = pictures
    assert (result[row, column] == 0).all() or np.isfinite(bad)
    far = away(row, column, 0)
    np.testing.assert_array_equal(result[far], usual[far])


def test_conductances_around_it_are_finite() -> None:
    guide = jnp.asarray(GUIDE).at[3, 4].set(jnp.nan)
    for edges, usual in zip(hyjax.conductance(guide, 0.1), hyjax.conductance(GUIDE, 0.1)):
        assert np.isfinite(edges).all() and (np.asarray(edges) != np.asarray(usual)).sum() == 2
    with pytest.raises(hyjax.InputError, match=r"^kappa"):
        hyjax.conductance(guide, np.nan)


def test_the_derivative_by_kappa_is_finite_beside_it() -> None:
    guide = jnp.asarray(GUIDE).at[3, 4].set(jnp.nan)

    def inflow(kappa: float, guide: jax.Array) -> jax.Array:
        return sum(jnp.sum(edges) for edges in hyjax.conductance(guide, kappa))  # type: ignore[return-value]

    usual, beside = (float(jax.grad(inflow)(0.1, g)) for g in (jnp.asarray(GUIDE), guide))
    assert 0 < beside < usual


def test_a_huge_value_under_a_small_kappa() -> None:
    """All four weights of a pixel are next to nothing; their mean is one all the same."""
    guide = GUIDE.copy()
    guide[5, 7] = 9e14
    up = hyjax.guided_upsample(LIGHT[::2, ::2], 2, guide, 1e-4)
    assert np.isfinite(up).all() and float(up.min()) >= LIGHT.min() and float(up.max()) <= LIGHT.max()


@pytest.mark.parametrize("fidelity", [0.1, 1e5])
def test_bright_light_in_half_precision(fidelity: float) -> None:
    """Sums over cells and λ α times the light are beyond half precision; neither becomes infinite."""
    light, guide = jnp.full((16, 16, 1), 300.0, jnp.float16), jnp.asarray(GUIDE[:16, :16], jnp.float16)
    np.testing.assert_array_equal(hyjax.downsample(light, 16), 300.0)
    schedule = hyjax.Schedule.uniform([(16, 2), (4, 2)], fidelity=fidelity)
    for pooling in ("edges", "guide"):
        ours = dataclasses.replace(schedule, pooling=pooling)
        for smooth in (
            hyjax.cascade(light, guide, ours),
            hyjax.cascade_known(light, jnp.ones_like(light), guide, ours),
        ):
            assert smooth.dtype == light.dtype
            np.testing.assert_allclose(smooth.astype(jnp.float32), 300.0, rtol=0.01)
