"""The sRGB curve, luminance, black bodies, and filter times frame."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyjax import InputError, blackbody, composite, luminance, to_display, to_linear
from hyjax.light.color import (
    SHOULDER,
    WHITE,
    WIDTH,
    _power,
    decoded,
    encoded,
    held,
    released,
    to_display_bytes,
)
from hyjax.photo_light.radiance import linear as linear_of


def test_known_values() -> None:
    """IEC 61966-2-1: mid grey 128/255 is 21.586 % of white, 18 % grey is 117.65/255; 12.92 below the toe."""
    np.testing.assert_allclose(to_linear(jnp.array([0.0, 128 / 255, 1.0])), [0.0, 0.2158605, WHITE], rtol=1e-5)
    np.testing.assert_allclose(to_display(jnp.array([0.0, 0.18, WHITE])) * 255, [0.0, 117.6465, 255.0], rtol=1e-4)
    np.testing.assert_allclose(decoded(jnp.array([128 / 255, 1.0])), [0.2158605, 1.0], rtol=1e-5)
    np.testing.assert_allclose(to_linear(jnp.array([0.02])), [0.02 / 12.92], rtol=1e-6)
    np.testing.assert_allclose(to_display(jnp.array([0.001])), [0.01292], rtol=1e-6)


def test_single_precision_is_that_of_powers_to_rounding() -> None:
    x = np.linspace(0.0, 1.0, 4097, dtype=np.float32)
    exact = x.astype(np.float64)
    linear = np.where(exact <= 0.04045, exact / 12.92, ((exact + 0.055) / 1.055) ** 2.4)
    display = np.where(exact <= 0.0031308, exact * 12.92, 1.055 * exact ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(decoded(jnp.asarray(x)), linear, rtol=1e-6)
    np.testing.assert_allclose(encoded(jnp.asarray(x)), display, rtol=1e-6)


def test_the_shoulder_is_reinhards() -> None:
    """Equation 4 of 2002, L (1 + L/w²) / (1 + L), in units of what is left above its start."""
    light = np.linspace(0.0, WHITE, 4097)
    above = (light - 0.7) / 0.3
    wanted = np.where(light < 0.7, light, 0.7 + 0.3 * above * (1 + above / WIDTH**2) / (1 + above))
    assert pytest.approx(WHITE - 0.7) == WIDTH * 0.3 and SHOULDER == 0.7
    np.testing.assert_allclose(held(light), wanted, rtol=1e-12)
    np.testing.assert_allclose(released(held(light)), light, rtol=1e-9)
    np.testing.assert_allclose(released(held(jnp.asarray(light, jnp.float32))), light, rtol=2e-6)
    np.testing.assert_allclose(held(WHITE + light), 1.0 + light)  # straight on beyond white
    np.testing.assert_allclose(released(1.0 + light), WHITE + light)
    with jax.enable_x64(True):
        slope = jax.vmap(jax.grad(held))(jnp.asarray(light))
        np.testing.assert_allclose(slope[1:-1], (held(light[2:]) - held(light[:-2])) / (2 * light[1]), rtol=2e-3)
        assert slope[light < 0.7].min() == 1.0 and np.all(np.diff(slope[light > 0.701][:-1]) < 0)


def test_numpys_decoding_is_to_linear() -> None:
    x = np.linspace(0.0, 1.0, 4097)
    np.testing.assert_allclose(linear_of(x), to_linear(jnp.asarray(x, jnp.float32)), rtol=3e-6, atol=1e-9)


def test_bytes_come_back_as_they_were() -> None:
    values = np.arange(256)
    np.testing.assert_array_equal(to_display_bytes(to_linear(jnp.asarray(values / 255, jnp.float32))), values)


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
@pytest.mark.parametrize("exponent", [2.4, 1 / 2.4])
def test_powers_of_half_precision_are_rounded_once(dtype: type, exponent: float) -> None:
    x = jnp.linspace(0.05, 1.0, 200).astype(dtype)
    found, exact = _power(x, exponent), np.asarray(x, np.float64) ** exponent
    assert found.dtype == dtype
    np.testing.assert_allclose(np.asarray(found, np.float64), exact, rtol=0.51 * float(jnp.finfo(dtype).eps))


@given(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_round_trip(values: list[float]) -> None:
    with jax.enable_x64(True):
        x = jnp.array(values)
        np.testing.assert_allclose(to_linear(to_display(WHITE * x)), WHITE * x, atol=1e-8)
        np.testing.assert_allclose(to_display(to_linear(x)), x, atol=2e-7)


def test_half_precision_keeps_every_byte_and_what_is_not_finite_stays_so() -> None:
    values = jnp.arange(256) / 255
    for dtype in (jnp.float16, jnp.float32):
        light = to_linear(values.astype(dtype))
        assert light.dtype == dtype
        np.testing.assert_array_equal(to_display_bytes(light), np.arange(256))
    np.testing.assert_allclose(to_display(jnp.array([-jnp.inf, jnp.inf])), [0.0, 1.0], atol=1e-6)
    assert np.isnan(to_display(jnp.array([jnp.nan]))).all() and np.isnan(to_linear(jnp.array([jnp.nan]))).all()


def test_gradients_where_the_shoulder_begins_and_ends() -> None:
    """One side's, not the mean of both."""
    slope = jax.grad(held)
    assert float(slope(SHOULDER)) == 1.0
    assert float(slope(WHITE)) == pytest.approx(2 / (WIDTH * (1 + WIDTH)), rel=1e-4)
    assert float(jax.grad(released)(1.0)) == pytest.approx(WIDTH * (1 + WIDTH) / 2, rel=1e-4)


def test_monotone_without_a_jump_and_gradients_are_finite() -> None:
    for curve, most in ((to_linear, 1.0), (to_display, WHITE)):
        x = jnp.linspace(0.0, most, 4097)
        y = np.asarray(curve(x))
        assert np.all(np.diff(y) > 0) and np.diff(y).max() < 14 * most / 4096
        gradient = np.asarray(jax.vmap(jax.grad(curve))(x))
        assert np.all(np.isfinite(gradient)) and np.all(gradient[:-1] > 0)
        np.testing.assert_allclose(gradient[0], 12.92 if curve is to_display else 1 / 12.92, rtol=1e-5)


def test_display_clips() -> None:
    x = jnp.array([-1.0, WHITE, 300.0])
    np.testing.assert_allclose(to_display(x), [0.0, 1.0, 1.0], rtol=1e-6)
    assert np.all(np.isfinite(jax.vmap(jax.grad(to_display))(x)))
    assert np.all(np.isfinite(jax.vmap(jax.grad(to_linear))(jnp.array([-0.5, 2.0]))))


def test_luminance() -> None:
    np.testing.assert_allclose(luminance(jnp.eye(3)), [0.2126, 0.7152, 0.0722], rtol=1e-6)
    np.testing.assert_allclose(luminance(jnp.ones((2, 5, 3))), np.ones((2, 5)), rtol=1e-6)


@pytest.mark.parametrize("kelvin", [1667.0, 1900.0, 2222.0, 2700.0, 4000.0, 6500.0, 10000.0, 25000.0])
def test_blackbody_has_luminance_one(kelvin: float) -> None:
    rgb = blackbody(kelvin)
    np.testing.assert_allclose(luminance(rgb), 1.0, rtol=1e-5)
    assert np.all(np.asarray(rgb) >= 0)


@pytest.mark.parametrize("kelvin", [0, -5, float("nan"), 1600.0, 25001])
def test_blackbody_out_of_range(kelvin: float) -> None:
    with pytest.raises(InputError, match=r"^kelvin: must be from 1667 to 25000 K, got"):
        blackbody(kelvin)


def test_blackbody_hue() -> None:
    """Lamps are orange, D65 is about white, the sky is blue, and there is no jump where the fits meet."""
    lamp, day, sky = np.asarray(blackbody(2700.0)), np.asarray(blackbody(6504.0)), np.asarray(blackbody(15000.0))
    assert lamp[0] > lamp[1] > lamp[2] and sky[2] > sky[1] > sky[0]
    np.testing.assert_allclose(day, 1.0, atol=0.05)
    # Planck's law integrated with the CIE 1931 observer: chromaticity of 2700 K is (0.4599, 0.4106).
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )
    xyz = to_xyz @ lamp
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), [0.4599, 0.4106], atol=2e-3)
    kelvin = jnp.linspace(1700.0, 20000.0, 2000)
    ratio = np.asarray(jax.jit(jax.vmap(blackbody))(kelvin))
    blue_to_red = ratio[:, 2] / ratio[:, 0]
    assert np.all(np.diff(blue_to_red) >= -1e-6) and np.diff(blue_to_red).max() < 0.02
    assert np.isfinite(jax.grad(lambda k: blackbody(k)[2])(4000.0))


def test_composite() -> None:
    """Eq. 1: S = R ⊙ C; one channel or three."""
    r, c = (np.random.default_rng(k).uniform(size=(4, 5, 3)).astype(np.float32) for k in (0, 1))
    np.testing.assert_array_equal(composite(jnp.asarray(r), jnp.asarray(c)), r * c)
    np.testing.assert_array_equal(composite(jnp.asarray(r[..., :1]), jnp.asarray(c)), r[..., :1] * c)
    for bad in (r[1:], r[..., :2]):
        with pytest.raises(InputError, match=r"frame"):
            composite(jnp.asarray(bad), jnp.asarray(c))
