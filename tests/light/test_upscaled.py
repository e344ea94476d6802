"""Frames that are relit at a part of their size: the filter is brought to full size, the frame's texture stays."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float

from hyjax import GBuffer, InputError, Relit, Schedule, Shaded, View, relight, to_linear
from hyjax.core.pyramid import downsample, level_shape
from hyjax.core.upsampling import guided_upsample
from hyjax.light.compositing import composite
from hyjax.light.emission import Emission

SCHEDULE = Schedule.uniform([(4, 3), (2, 3)], kappa=0.2)
SHADOWS = Schedule.uniform([(2, 2)], kappa=0.2)
SIZES = [(48, 64, 2), (45, 61, 2), (47, 64, 3), (48, 50, 4)]


def frame_of(height: int, width: int, seed: int = 0) -> Float[Array, "h w 3"]:
    return jnp.asarray(np.random.default_rng(seed).uniform(0.1, 0.9, (height, width, 3)), jnp.float32)


def view_of(display: Float[Array, "h w 3"]) -> View:
    shape = display.shape[:2]
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (*shape, 3))
    return View.of(display, GBuffer(jnp.zeros((*shape, 3)), up, jnp.ones(shape), jnp.ones(shape, bool)))


def shaded_of(shape: tuple[int, int], lux: Any = 150.0, **changes: Any) -> Shaded:
    light = jnp.broadcast_to(jnp.asarray(lux, jnp.float32), (*shape, 1))
    return Shaded(
        light,
        jnp.ones_like(light),
        jnp.array([[1.0, 0.8, 0.5]]),
        jnp.ones((*shape, 1)),
        jnp.array(100.0),
        jnp.full(3, 0.3),
        **changes,
    )


def relit(shaded: Shaded, display: Float[Array, "h w 3"], factor: int, **options: Any) -> Relit:
    view = view_of(downsample(display, factor))
    return relight(view, shaded, view.display, SCHEDULE, shadow_schedule=SHADOWS, full=display, **options)


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "factor"), SIZES)
def test_a_constant_filter_is_exact(height: int, width: int, factor: int) -> None:
    """And so what relighting at full size makes of the frame."""
    display = frame_of(height, width)
    small = relit(shaded_of(level_shape((height, width), factor)), display, factor)
    whole = relit(shaded_of((height, width)), display, 1)
    for field in dataclasses.fields(Relit):
        one, other = getattr(small, field.name), getattr(whole, field.name)
        assert one.shape == other.shape == (height, width, 3)
        if field.name not in ("image", "unrefined"):
            np.testing.assert_allclose(one, other, atol=2e-6, err_msg=field.name)
    np.testing.assert_allclose(small.image, whole.image, atol=2e-6)
    np.testing.assert_allclose(small.image, 1.5 * jnp.array([1.0, 0.8, 0.5]) * to_linear(display), rtol=1e-5)


@given(st.integers(0, 2**31))
@settings(max_examples=8)
def test_the_filter_is_interpolated_under_the_frame(seed: int) -> None:
    """Of any light: it is `guided_upsample` of the smaller frame's, and multiplies the frame at full size."""
    display, shape = frame_of(32, 40, seed), (16, 20)
    lux = np.random.default_rng(seed).uniform(0, 300, (*shape, 1))
    found = relit(shaded_of(shape, lux), display, 2)
    view = view_of(downsample(display, 2))
    plain = relight(view, shaded_of(shape, lux), view.display, SCHEDULE, shadow_schedule=SHADOWS)
    kappa = SCHEDULE.levels[-1].kappa
    whole = guided_upsample(plain.relight_filter, 2, display, kappa, coarse=view.display)
    np.testing.assert_allclose(found.relight_filter, whole, atol=1e-5)
    np.testing.assert_allclose(found.image, composite(whole, to_linear(display)), atol=1e-5)
    least, most = plain.relight_filter.min(), plain.relight_filter.max()
    assert least - 1e-5 <= found.relight_filter.min() and found.relight_filter.max() <= most + 1e-5


def test_what_shines_is_kept() -> None:
    """A pane shows what it sends, not the frame: in the left half, away from its border."""
    height, width, factor = 48, 64, 2
    shape = level_shape((height, width), factor)
    left = jnp.broadcast_to((jnp.arange(shape[1]) < shape[1] // 2)[None, :, None], (*shape, 1)).astype(jnp.float32)
    sent = jnp.broadcast_to(jnp.array([2.0, 1.0, 0.5]), (*shape, 3))
    emission = Emission(left, sent, *2 * [jnp.zeros((*shape, 3))])
    display = frame_of(height, width)
    dark, shining = (
        relit(shaded_of(shape), display, factor),
        relit(shaded_of(shape, emission=emission), display, factor),
    )
    middle = width // 2
    pane = shining.image[:, : middle - factor]
    np.testing.assert_allclose(pane, jnp.broadcast_to(sent[0, 0], pane.shape), atol=1e-5)
    np.testing.assert_allclose(shining.image[:, middle + factor :], dark.image[:, middle + factor :], atol=1e-5)
    np.testing.assert_allclose(shining.relight_filter, dark.relight_filter, atol=1e-5)


def test_no_shining_pixel_is_none() -> None:
    shape = (16, 20)
    none = Emission(jnp.zeros((*shape, 1)), *2 * [jnp.ones((*shape, 3))], jnp.zeros((*shape, 3)))
    display = frame_of(32, 40)
    one, other = relit(shaded_of(shape, emission=none), display, 2), relit(shaded_of(shape), display, 2)
    np.testing.assert_allclose(one.image, other.image, atol=1e-6)


@pytest.mark.parametrize(
    ("size", "factor"), [((17, 100), 8), ((5, 64), 4), ((2, 61), 3), ((1, 640), 2), ((61, 2), 3), ((41, 64), 8)]
)
def test_narrow_frames_are_brought_to_their_size(size: tuple[int, int], factor: int) -> None:
    display = frame_of(*size)
    assert relit(shaded_of(level_shape(size, factor)), display, factor).image.shape == display.shape


@pytest.mark.parametrize("size", [(32, 41), (33, 40), (40, 32), (16, 40), (15, 20), (64, 81)])
def test_sizes_that_do_not_fit_are_refused(size: tuple[int, int]) -> None:
    view = view_of(frame_of(16, 20))
    with pytest.raises(InputError, match="at a whole part of its size"):
        relight(view, shaded_of((16, 20)), view.display, SCHEDULE, shadow_schedule=SHADOWS, full=frame_of(*size))


def test_the_papers_form_works_at_full_size() -> None:
    with pytest.raises(InputError, match="mode 'paper' works at full size"):
        relit(shaded_of((16, 20)), frame_of(32, 40), 2, mode="paper")
