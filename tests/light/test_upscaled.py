"""Frames that are relit at a part of their size: the filter is brought to full size, the frame's texture stays."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float

from hyjax import GBuffer, InputError, Relit, Schedule, Shaded, View, relight, to_linear
from hyjax.core.pyramid import downsample, level_shape, upsample
from hyjax.core.upsampling import guided_upsample
from hyjax.light.compositing import composite
from hyjax.light.emission import Emission, Emitters
from hyjax.light.emission import emission as emission_of
from hyjax.light.panes import Bars

SCHEDULE = Schedule.uniform([(4, 3), (2, 3)], kappa=0.2, upsampling="guide")
SHADOWS = Schedule.uniform([(2, 2)], kappa=0.2)
SIZES = [(48, 64, 2), (45, 61, 2), (47, 64, 3), (48, 50, 4)]


def frame_of(height: int, width: int, seed: int = 0) -> Float[Array, "h w 3"]:
    return jnp.asarray(np.random.default_rng(seed).uniform(0.1, 0.9, (height, width, 3)), jnp.float32)


def view_of(display: Float[Array, "h w 3"], full: Float[Array, "h w 3"] | None = None) -> View:
    shape = display.shape[:2]
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (*shape, 3))
    gbuffer = GBuffer(jnp.zeros((*shape, 3)), up, jnp.ones(shape), jnp.ones(shape, bool))
    return View.of(display, gbuffer, full=full)


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
    view = view_of(downsample(display, factor), display)
    return relight(view, shaded, view.display, SCHEDULE, shadow_schedule=SHADOWS, **options)


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


@pytest.mark.parametrize(("height", "width", "factor"), SIZES)
def test_what_shines_is_drawn_at_full_size(height: int, width: int, factor: int) -> None:
    """A pane shows what it sends and reflects, to the pixel; a bar is darker for its light in the photo."""
    rng, shape = np.random.default_rng(factor), level_shape((height, width), factor)
    weight, framed = (jnp.asarray(rng.random((height, width, 1)) < 0.3, jnp.float32) for _ in range(2))
    sent, reflectance = (jnp.asarray(rng.random((height, width, 3)), jnp.float32) for _ in range(2))
    emission = Emission(weight, sent, reflectance, 3.0 * (1.0 - weight) * framed * jnp.ones(3))
    display = frame_of(height, width)
    found, plain = (
        relit(shaded_of(shape, photo_light=jnp.ones((*shape, 3)), emission=own), display, factor)
        for own in (emission, None)
    )
    light = 1.5 * jnp.array([1.0, 0.8, 0.5])
    beside = jnp.where(emission.frame_light > 0, 1 / 3, 1.0) * light * to_linear(display)
    expected = jnp.where(weight > 0, sent + reflectance * light, beside)
    np.testing.assert_allclose(found.image, expected, rtol=1e-5, atol=1e-5)
    untouched = (weight + framed)[..., 0] == 0
    for field in dataclasses.fields(Relit):
        one, other = getattr(found, field.name), getattr(plain, field.name)
        np.testing.assert_allclose(one[untouched], other[untouched], atol=1e-5, err_msg=field.name)
    np.testing.assert_allclose(found.refined * found.visibility, found.relight_filter, atol=1e-5)


def test_a_source_has_the_border_of_a_picture_at_full_size() -> None:
    """A lamp before a wall, drawn in a frame that is relit at a third of its size as in the whole one."""
    height, width, factor = 60, 90, 3
    emitters = Emitters(
        jnp.zeros((0, 3, 3)),
        Bars.none(0),
        jnp.array([[0.1, 0.05, 2.0, 0.15]]),
        jnp.array([[0.9, 0.8, 0.7]]),
        jnp.zeros((1, 3)),
        jnp.ones(3),
        jnp.zeros((0, 3)),
    )

    def wall(shape: tuple[int, int]) -> GBuffer:
        depth, none = jnp.full(shape, 2.5), jnp.zeros((*shape, 3))
        return GBuffer(none, none, depth, jnp.ones(shape, bool))

    full, pose = jnp.ones((height, width, 3)), jnp.eye(4)
    matrix = np.array([[80.0, 0, 45], [0, 80, 30], [0, 0, 1]], np.float32)
    small = jnp.asarray(matrix / np.array([[factor], [factor], [1]]), jnp.float32)
    seen = level_shape((height, width), factor)
    whole = emission_of(emitters, to_linear(full), wall((height, width)).open_depth, pose, jnp.asarray(matrix))
    assert 20 < float(whole.weight.sum()) < 1000

    def drawn(picture: Float[Array, "h w 3"], surface: GBuffer) -> Emission:
        view = View.of(downsample(picture, factor), surface, pose=pose, intrinsics=small, full=picture)
        return emission_of(emitters, view.source_frame(), *view.source_surface())

    found = drawn(full, wall(seen))
    for field in dataclasses.fields(Emission):
        np.testing.assert_allclose(getattr(found, field.name), getattr(whole, field.name), atol=1e-5)
    near = dataclasses.replace(wall(seen), depth=jnp.where(jnp.arange(seen[1]) < 16, 1.0, 2.5) * jnp.ones(seen))
    hidden = drawn(full.at[:, :48].set(0.9), near)  # what stands before the left of the lamp
    assert not hidden.weight[:, :48].any()
    np.testing.assert_allclose(hidden.weight[:, 48:], whole.weight[:, 48:], atol=1e-5)


def test_no_shining_pixel_is_none() -> None:
    shape, full = (16, 20), (32, 40)
    none = Emission(jnp.zeros((*full, 1)), *2 * [jnp.ones((*full, 3))], jnp.zeros((*full, 3)))
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
    with pytest.raises(InputError, match="at a whole part of its size"):
        view_of(frame_of(16, 20), frame_of(*size))


def test_sources_of_large_pictures_are_brought_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn at a half where a picture is four times as large as a usual one: the same away from their borders."""
    display, small = frame_of(48, 64), level_shape((48, 64), 4)
    left = jnp.broadcast_to((jnp.arange(64) < 32)[None, :, None], (48, 64, 1)).astype(jnp.float32)
    sent = jnp.broadcast_to(jnp.array([2.0, 1.0, 0.5]), (48, 64, 3))
    whole = Emission(left, sent, *2 * [jnp.zeros((48, 64, 3))])
    expected = relit(shaded_of(small, emission=whole), display, 4)
    monkeypatch.setattr("hyjax.light.view.USUAL_PIXELS", 48 * 64 // 4)
    assert view_of(downsample(display, 4), display).source_factor == 2
    half = jax.tree.map(lambda x: x[::2, ::2], whole)
    found = relit(shaded_of(small, emission=half), display, 4)
    for beside in (slice(0, 30), slice(34, 64)):
        np.testing.assert_allclose(found.image[:, beside], expected.image[:, beside], atol=1e-5)
        np.testing.assert_allclose(found.unrefined[:, beside], expected.unrefined[:, beside], atol=1e-5)


def test_a_tiny_picture_says_how_many_times_larger_it_is() -> None:
    """Of 9 x 5 pixels, a quarter and a third are of one size."""
    small, surface = frame_of(3, 2), view_of(frame_of(3, 2)).gbuffer
    assert View.of(small, surface, full=frame_of(9, 5)).factor == 3
    assert View.of(small, surface, full=frame_of(9, 5), factor=4).factor == 4
    with pytest.raises(InputError, match="at a whole part of its size"):
        View.of(small, surface, full=frame_of(9, 5), factor=5)


def test_emission_is_of_the_whole_picture() -> None:
    shape, display = (16, 20), frame_of(32, 40)
    small = Emission(jnp.ones((*shape, 1)), *3 * [jnp.ones((*shape, 3))])
    with pytest.raises(InputError, match=r"emission .16, 20. must be of .32, 40., as sources are drawn"):
        relit(shaded_of(shape, emission=small), display, 2)


def test_the_filter_is_brought_up_as_the_schedule_says() -> None:
    """Bilinearly where its levels are, and by its norm."""
    display, shape = frame_of(32, 40), (16, 20)
    lux = np.random.default_rng(0).uniform(0, 300, (*shape, 1))
    view = view_of(downsample(display, 2), display)
    for upsampling, norm in (("bilinear", "l2"), ("guide", "mean_abs")):
        schedule = dataclasses.replace(SCHEDULE, upsampling=upsampling, norm=norm)
        own = {"shadow_schedule": SHADOWS}
        small = relight(view_of(view.display), shaded_of(shape, lux), view.display, schedule, **own).relight_filter
        found = relight(view, shaded_of(shape, lux), view.display, schedule, **own).relight_filter
        if upsampling == "bilinear":
            expected = upsample(small, 2, (32, 40))
        else:
            expected = guided_upsample(small, 2, display, SCHEDULE.levels[-1].kappa, coarse=view.display, norm=norm)
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_papers_form_works_at_full_size() -> None:
    with pytest.raises(InputError, match="mode 'paper' works at full size"):
        relit(shaded_of((16, 20)), frame_of(32, 40), 2, mode="paper")
