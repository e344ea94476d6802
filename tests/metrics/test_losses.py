"""The objective: what it must see, what it must not, and that nobody gets away with a filter of one colour."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.differences import assert_gradients

import hyjax
from hyjax import InputError
from hyjax.data.builtin_room import load_room
from hyjax.data.frames import fit
from hyjax.geometry.raycast import RayCaster
from hyjax.light.color import WHITE
from hyjax.light.shading import colored, shade_each
from hyjax.metrics.losses import (
    EPSILON,
    SCALES,
    LossWeights,
    charbonnier,
    display_loss,
    display_unclipped,
    filter_loss,
)
from hyjax.scene.light_places import survey_capture
from hyjax.scene.light_setups import named_setup
from hyjax.scene.surfaces import surface_of

pytestmark = pytest.mark.usefixtures("strict_ranks")

SIZES = [(1, 1), (1, 6), (9, 8), (13, 70)]  # few: every one is compiled anew
sizes = st.sampled_from(SIZES)
seeds = st.integers(0, 2**31)
PIXEL, GRADIENT = LossWeights(gradient=0.0), LossWeights(pixel=0.0)
value_and_slopes = jax.jit(jax.value_and_grad(filter_loss, argnums=(0, 1, 2)))

Inputs = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def inputs(seed: int, size: tuple[int, int], holes: float = 0.3) -> Inputs:
    """Filter, target, frame and validity. Some values are black, some products above white."""
    rng = np.random.default_rng(seed)
    relight_filter, target = rng.uniform(-0.2, 3.0, (2, *size, 3)).clip(0.0)
    frame = rng.uniform(-0.1, 1.0, (*size, 3)).clip(0.0)
    valid = rng.uniform(size=size) >= holes
    valid.flat[0] = True
    return relight_filter.astype(np.float32), target.astype(np.float32), frame.astype(np.float32), valid


# ---- the formula ----


def rho(x: float) -> float:
    return float(np.sqrt(x * x + EPSILON * EPSILON) - EPSILON)


def encode(x: float) -> float:
    """sRGB's curve over the shoulder of Reinhard et al., which is left at white."""
    if x > 0.7:
        t, w = (min(x, 1.2) - 0.7) / 0.3, 0.5 / 0.3
        x = 0.7 + 0.3 * t * (1 + t / w**2) / (1 + t) + max(x - 1.2, 0.0)
    return 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055


def loop_terms(relight_filter: np.ndarray, target: np.ndarray, frame: np.ndarray, valid: np.ndarray) -> list[float]:
    """Pixel and gradient term, an edge and a pixel at a time."""
    h, w = valid.shape
    d = np.array(
        [
            [[encode(float(relight_filter[i, j, c]) * frame[i, j, c]) for c in range(3)] for j in range(w)]
            for i in range(h)
        ]
    ) - np.array(
        [[[encode(float(target[i, j, c]) * frame[i, j, c]) for c in range(3)] for j in range(w)] for i in range(h)]
    )
    pixels = [rho(d[i, j, c]) for i in range(h) for j in range(w) for c in range(3) if valid[i, j]]
    pixel = float(np.mean(pixels)) if pixels else 0.0
    slopes = 0.0
    for s in SCALES:
        mean, share = {}, {}
        for i in range(-(-h // s)):
            for j in range(-(-w // s)):
                cell = np.s_[i * s : (i + 1) * s, j * s : (j + 1) * s]
                share[i, j] = valid[cell].sum() / s**2
                mean[i, j] = d[cell][valid[cell]].sum(0) / max(valid[cell].sum(), 1)
        total = count = 0.0
        for i, j in mean:
            for other in ((i + 1, j), (i, j + 1)):
                if other in mean:
                    weight = share[i, j] * share[other]
                    total += weight * sum(rho(x) for x in mean[other] - mean[i, j])
                    count += 3 * weight
        slopes += total / count if count > 0 else 0.0
    return [pixel, slopes / len(SCALES)]


@given(sizes, seeds, st.sampled_from([0.0, 0.4, 0.9]))
def test_loss_is_the_loops(size: tuple[int, int], seed: int, holes: float) -> None:
    case = inputs(seed, size, holes)
    expected = loop_terms(*(x.astype(np.float64) for x in case[:3]), case[3])
    for weights, value in zip((PIXEL, GRADIENT), expected, strict=True):
        np.testing.assert_allclose(filter_loss(*case, weights=weights), value, rtol=2e-5, atol=1e-8)
    both = filter_loss(*case, weights=LossWeights(2.0, 3.0))
    np.testing.assert_allclose(both, 2 * expected[0] + 3 * expected[1], rtol=2e-5, atol=1e-8)


def test_charbonnier_in_numbers() -> None:
    x = np.array([0.0, 3e-6, EPSILON, -1.0])
    expected = [0.0, 9e-12 / (2 * EPSILON), (2**0.5 - 1) * EPSILON, 1.0 - EPSILON + EPSILON**2 / 2]
    np.testing.assert_allclose(charbonnier(jnp.asarray(x, jnp.float32)), expected, rtol=1e-6)
    np.testing.assert_allclose(charbonnier(jnp.array([3.0]), epsilon=4.0), [1.0], rtol=1e-6)


@given(seeds)
def test_display_unclipped_is_to_display_up_to_white(seed: int) -> None:
    relight_filter, _, frame, _ = inputs(seed, (9, 8))
    seen, linear = np.asarray(display_unclipped(relight_filter, frame)), relight_filter * frame
    np.testing.assert_allclose(np.minimum(seen, 1.0), hyjax.to_display(jnp.asarray(linear)), atol=1e-6)
    assert (linear > WHITE).any() and np.all(seen[linear > 1.0001 * WHITE] > 1.0)


def test_too_bright_light_is_called_back() -> None:
    """Where a screen would clip to white the loss still falls on the way back."""
    white = jnp.ones((9, 8, 3))
    slope, *_ = value_and_slopes(3.0 * white, white, white, jnp.ones((9, 8), bool))[1]
    assert jnp.sum(slope) > 0.1


# ---- gradients ----


def test_gradients() -> None:
    with jax.enable_x64(True):
        # Away from the corner that the sRGB curve has where its pieces meet; two cells of the coarsest scale.
        relight_filter, target, frame, valid = inputs(1, (13, 70))
        for weights in (PIXEL, GRADIENT):
            assert_gradients(
                lambda f, t, c, w=weights: filter_loss(f, t, c, jnp.asarray(valid), weights=w),
                relight_filter + 0.1,
                target + 0.1,
                frame + 0.1,
            )


def test_forward_and_second_derivatives_agree_with_the_reverse() -> None:
    with jax.enable_x64(True):
        relight_filter, target, frame, valid = (jnp.asarray(x, x.dtype) for x in inputs(2, (9, 8)))
        direction = jnp.asarray(np.random.default_rng(0).normal(size=(9, 8, 3)))
        loss = jax.jit(lambda s: filter_loss(relight_filter + 0.1 + s * direction, target, frame + 0.1, valid))
        _, forward = jax.jvp(loss, (0.0,), (1.0,))
        slope = jax.jit(jax.grad(loss))
        np.testing.assert_allclose(forward, slope(0.0), rtol=1e-10)
        np.testing.assert_allclose(jax.jit(jax.grad(slope))(0.0), (slope(1e-6) - slope(-1e-6)) / 2e-6, rtol=1e-4)


def test_gradients_are_finite_at_black_at_white_and_at_the_target() -> None:
    levels = np.array([0.0, 1e-30, 0.0031308, WHITE, 50.0], np.float32)
    grid = np.broadcast_to(np.stack(np.meshgrid(levels, levels), -1).reshape(5, 5, 2)[..., :1], (5, 5, 3)).copy()
    valid = np.ones((5, 5), bool)
    for target in (grid, np.zeros_like(grid), grid[::-1].copy()):
        for frame in (np.zeros_like(grid), np.ones_like(grid), grid.transpose(1, 0, 2).copy()):
            for slope in value_and_slopes(grid, target, frame, valid)[1]:
                assert np.all(np.isfinite(slope))
    assert not np.any(value_and_slopes(grid, grid, np.ones_like(grid), valid)[1][0])


def test_black_pixels_have_a_slope() -> None:
    """A filter that starts at zero is not stuck there."""
    zero, one = jnp.zeros((9, 8, 3)), jnp.ones((9, 8, 3))
    assert np.all(np.asarray(value_and_slopes(zero, one, 0.5 * one, jnp.ones((9, 8), bool))[1][0]) < 0)


# ---- what it must see ----


@given(sizes, seeds)
def test_zero_at_equality_and_only_there(size: tuple[int, int], seed: int) -> None:
    relight_filter, target, frame, valid = inputs(seed, size)
    assert filter_loss(target, target, frame, valid) == 0
    visible = np.any(
        (display_unclipped(relight_filter, frame) != display_unclipped(target, frame)) & valid[..., None]
    )
    assert (filter_loss(relight_filter, target, frame, valid) > 0) == visible
    other = target.copy()
    other[0, 0, 1] += 1e-3
    frame[0, 0, 1] = 0.5
    assert filter_loss(other, target, frame, valid) > 0


@given(sizes, seeds)
def test_symmetries(size: tuple[int, int], seed: int) -> None:
    relight_filter, target, frame, valid = case = inputs(seed, size)
    loss = filter_loss(*case)
    np.testing.assert_allclose(filter_loss(target, relight_filter, frame, valid), loss, rtol=1e-5)
    np.testing.assert_allclose(filter_loss(*(x[..., [2, 0, 1]] for x in case[:3]), valid), loss, rtol=1e-5)
    np.testing.assert_allclose(filter_loss(*(np.swapaxes(x, 0, 1) for x in case)), loss, rtol=1e-5)


@pytest.mark.parametrize("flip", [np.flipud, np.fliplr])
def test_flips(flip: object) -> None:
    case = inputs(3, (64, 128))  # whole cells at every scale
    np.testing.assert_allclose(filter_loss(*(flip(x) for x in case)), filter_loss(*case), rtol=1e-5)  # type: ignore[operator]


def test_filling_up_with_invalid_pixels_changes_nothing() -> None:
    case = inputs(4, (20, 30))
    padded = [np.pad(x, [(0, 50), (0, 3)] + [(0, 0)] * (x.ndim - 2)) for x in case]
    np.testing.assert_allclose(filter_loss(*padded), filter_loss(*case), rtol=1e-5)


@given(sizes, seeds)
def test_a_dark_frame_weighs_less(size: tuple[int, int], seed: int) -> None:
    relight_filter, target, frame, valid = inputs(seed, size)
    bright, dark = (filter_loss(relight_filter, target, scale * frame, valid) for scale in (1.0, 0.05))
    assert dark < bright or bright == 0


@given(sizes, seeds)
def test_invalid_pixels_do_not_matter(size: tuple[int, int], seed: int) -> None:
    """Neither to the value nor to the gradient, whatever they hold."""
    relight_filter, target, frame, valid = inputs(seed, size)
    value, (*slopes, _) = value_and_slopes(relight_filter, target, frame, valid)
    for filler in (7.0, np.inf, np.nan):
        spoilt = (np.where(valid[..., None], x, np.float32(filler)) for x in (relight_filter, target))
        again, (*slopes_again, _) = value_and_slopes(*spoilt, frame, valid)
        np.testing.assert_array_equal(again, value)
        for slope, slope_again in zip(slopes, slopes_again, strict=True):
            np.testing.assert_array_equal(slope_again, slope)
            assert not np.any(np.asarray(slope_again)[~valid])


@pytest.mark.parametrize("size", SIZES)
def test_nothing_valid_is_zero(size: tuple[int, int]) -> None:
    case = inputs(0, size)[:3]
    value, (slope, *_) = value_and_slopes(*case, np.zeros(size, bool))
    assert value == 0 and not np.any(slope)


def test_jit_vmap_and_precomputed_target() -> None:
    cases = [inputs(seed, (9, 8)) for seed in range(3)]
    single = [filter_loss(*case) for case in cases]
    batch = [np.stack(arrays) for arrays in zip(*cases, strict=True)]
    np.testing.assert_allclose(jax.jit(jax.vmap(filter_loss))(*batch), single, rtol=1e-5)
    slopes = jax.jit(jax.vmap(jax.grad(filter_loss)))(*batch)
    np.testing.assert_allclose(slopes[1], value_and_slopes(*cases[1])[1][0], rtol=1e-4, atol=1e-8)
    relight_filter, target, frame, valid = cases[0]
    seen, target_seen = display_unclipped(relight_filter, frame), display_unclipped(target, frame)
    np.testing.assert_allclose(display_loss(seen, target_seen, valid), single[0], rtol=1e-6)
    assert single[0].dtype == np.float32 and single[0].shape == ()


# ---- the perceptual hook ----


def test_perceptual_gets_clipped_pictures_black_where_invalid() -> None:
    relight_filter, target, frame, valid = case = inputs(5, (9, 8))

    def distance(a: jax.Array, b: jax.Array) -> jax.Array:
        for picture, linear in ((a, relight_filter * frame), (b, target * frame)):
            expected = np.where(valid[..., None], hyjax.to_display(jnp.asarray(linear)), 0.0)
            np.testing.assert_allclose(picture, expected, atol=1e-6)
        return jnp.asarray(0.25)

    weights = LossWeights(perceptual=2.0)
    np.testing.assert_allclose(
        filter_loss(*case, weights=weights, perceptual=distance), filter_loss(*case) + 0.5, rtol=1e-6
    )


def test_perceptual_is_not_called_without_weight() -> None:
    def refuse(a: jax.Array, b: jax.Array) -> jax.Array:
        raise AssertionError

    filter_loss(*inputs(5, (9, 8)), perceptual=refuse)


# ---- no prize for having no edges ----


def best_constant(target: np.ndarray, frame: np.ndarray, valid: np.ndarray) -> jax.Array:
    """The one colour with the smallest loss, by search in every channel (in which the loss is a sum)."""
    level = np.median(target[valid], axis=0)
    for span, count in ((8.0, 25), (1.3, 9)):
        for channel in range(3):
            tries = [level * span ** (t * (np.arange(3) == channel)) for t in np.linspace(-1, 1, count)]
            losses = [filter_loss(constant(x, target), target, frame, valid) for x in tries]
            level = tries[int(np.argmin(losses))]
    return constant(level, target)


def constant(color: np.ndarray, like: np.ndarray) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(color, jnp.float32), like.shape)


def assert_blend_rises(start: np.ndarray, flat: jax.Array, *rest: np.ndarray) -> None:
    blends = [float(filter_loss((1 - t) * start + t * flat, *rest)) for t in np.linspace(0.0, 1.0, 9)]
    assert np.all(np.diff(blends) > 0), blends


def synthetic() -> Inputs:
    """Light that falls off, a corner between two walls, textured albedo."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:128, :160] / 128.0
    light = 0.8 / (0.3 + (x - 0.3) ** 2 + (y - 0.4) ** 2) * np.where(x > 0.7, 0.4, 1.0)
    target = (light[..., None] * [1.0, 0.8, 0.6]).astype(np.float32)
    frame = (0.05 + 0.4 * rng.uniform(size=(16, 20, 3)).repeat(8, 0).repeat(8, 1)).astype(np.float32)
    noise = np.exp(0.3 * rng.normal(size=(128, 160, 1)))
    holes = (rng.uniform(size=(16, 20, 1)) < 0.05).repeat(8, 0).repeat(8, 1)
    return target, (target * noise * ~holes).astype(np.float32), frame, np.ones((128, 160), bool)


def test_a_constant_filter_costs_more_than_a_noisy_one_with_holes() -> None:
    target, rough, frame, valid = synthetic()
    smooth = target * np.float32(1.05)
    flat = best_constant(target, frame, valid)
    good, noisy, bad = (float(filter_loss(f, target, frame, valid)) for f in (smooth, rough, flat))
    assert good < noisy < bad
    assert_blend_rises(target, flat, target, frame, valid)
    assert_blend_rises(smooth, flat, target, frame, valid)


@pytest.mark.slow
def test_a_constant_filter_is_not_rewarded_in_the_room() -> None:
    room = load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)
    rough, accurate = (RayCaster(surface_of(room, mesh, progress=False)[1]) for mesh in ("scan", "true"))
    with jax.numpy_rank_promotion("allow"):
        setup = named_setup("two-colors", survey_capture(accurate, room))
    lights, lux = setup.lights, setup.reference_lux
    for index in (0, 3, 5):
        view = fit(room[index], (256, 256))
        truth, seen, guide = accurate.gbuffer(view.camera), rough.gbuffer(view.camera), jnp.asarray(view.image)
        frame, valid = hyjax.to_linear(guide), np.asarray(truth.hit)
        with jax.numpy_rank_promotion("allow"):
            target = np.asarray(colored(shade_each(truth, lights), lights) / lux)
            seen_by_camera = hyjax.View.of(guide, seen)
            paper = hyjax.Schedule.preset("paper-80")
            relit = hyjax.relight(seen_by_camera, seen_by_camera.shade(setup), guide, paper)
        # The scan with its holes mended: black over a quarter of the picture is worse than no shading at all.
        mended = jnp.where(seen.hit[..., None], relit.shading, relit.refined)
        noise = np.exp(0.3 * np.random.default_rng(index).normal(size=(*valid.shape, 1)))
        flat = best_constant(target, frame, valid)
        filters = relit.refined, relit.shading, mended, (target * noise).astype(np.float32), flat
        good, raw, rough_loss, noisy, bad = (float(filter_loss(f, target, frame, valid)) for f in filters)
        assert good < raw and good < 0.8 * bad and rough_loss < 0.9 * bad and noisy < bad
        assert_blend_rises(target, flat, target, frame, valid)
        # What is not quite right gains a little where its errors shrink, and no more.
        blends = [
            float(filter_loss((1 - t) * relit.refined + t * flat, target, frame, valid)) for t in (0.1, 0.2, 0.4)
        ]
        assert min(blends) > 0.97 * good and blends[2] > blends[1] > good


# ---- errors ----


@pytest.mark.parametrize("which", range(4))
def test_sizes_must_agree(which: int) -> None:
    case = [*inputs(0, (9, 8))]
    case[which] = case[which][:-1]
    with pytest.raises(InputError, match=r"^(target|frame|valid): .* (h|w) is \d by relight_filter$") as caught:
        filter_loss(*case)
    assert "\n" not in str(caught.value)


def test_one_channel_is_refused() -> None:
    relight_filter, *rest = inputs(0, (9, 8))
    with pytest.raises(InputError, match=r"^relight_filter: .* h x w x 3, got float32 of shape \(9, 8, 1\)$"):
        filter_loss(relight_filter[..., :1], *rest)


def test_perceptual_weight_needs_its_function() -> None:
    with pytest.raises(InputError, match="needs a function"):
        filter_loss(*inputs(0, (9, 8)), weights=LossWeights(perceptual=1.0))


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_weights_are_checked(value: float) -> None:
    with pytest.raises(InputError, match="gradient: a loss weight"):
        LossWeights(gradient=value)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_epsilon_is_positive(value: float) -> None:
    with pytest.raises(InputError, match="epsilon"):
        charbonnier(jnp.zeros(3), epsilon=value)
