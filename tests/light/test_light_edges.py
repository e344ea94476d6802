"""Light edges of a photo: shares of light in its differences, and the estimate that follows them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyjax.configuration import Configuration
from hyjax.core.stencil import gradient
from hyjax.data.builtin_room import load_room
from hyjax.guide.edge_weights import edge_weights
from hyjax.light.color import to_linear
from hyjax.light.light_edges import (
    FEATURES,
    LEAST_LIGHT,
    LONGEST_SIDE,
    _blocks,
    _pixels,
    _pooling,
    corrected,
    edge_correction,
    edge_features,
    light_shares,
    sharpened,
)
from hyjax.light.view import View
from hyjax.pipeline import relight
from hyjax.scene.relighter import Relighter, refine
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.synthetic.random_room import make_random_room, photograph
from hyjax.util.errors import InputError

UNSEEN_SEED = 77
"""Seed of rooms that the network was not trained on."""


def fields(height: int, width: int, seed: int = 0) -> tuple[jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    return tuple(jnp.asarray(rng.normal(size=(height, width)), jnp.float32) for _ in range(2))  # type: ignore[return-value]


def even(height: int, width: int, value: float) -> tuple[jax.Array, jax.Array]:
    return jnp.full((height - 1, width), value), jnp.full((height, width - 1), value)


def test_where_all_is_paint_the_estimate_stays() -> None:
    photo, estimate = fields(9, 12)
    assert not corrected(photo, estimate, even(9, 12, 0.0)).any()


def test_where_all_is_light_the_estimate_has_the_differences_of_the_photo() -> None:
    photo, estimate = fields(9, 12)
    sharp = estimate + corrected(photo, estimate, even(9, 12, 1.0), 1e-6)
    for found, wanted in zip(gradient(sharp), gradient(photo), strict=True):
        np.testing.assert_allclose(np.asarray(found), np.asarray(wanted), atol=1e-3)
    assert float(jnp.mean(sharp - estimate)) == pytest.approx(0.0, abs=1e-3), "its mean stays"


@pytest.mark.parametrize("shape", [(8, 8), (7, 10), (5, 9)])
def test_shares_belong_to_edges_and_lie_between_nothing_and_all(shape: tuple[int, int]) -> None:
    down, right = light_shares(edge_weights(), jnp.zeros((*shape, FEATURES)))
    assert down.shape == (shape[0] - 1, shape[1]) and right.shape == (shape[0], shape[1] - 1)
    assert 0 <= float(min(down.min(), right.min())) <= float(max(down.max(), right.max())) <= 1


@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 3))
def test_blocks_come_back_as_pixels(height: int, width: int, channels: int) -> None:
    x = jnp.arange(4 * height * width * channels, dtype=jnp.float32).reshape(1, 2 * height, 2 * width, channels)
    np.testing.assert_array_equal(np.asarray(_pixels(_blocks(x))), np.asarray(x))


def test_weights_fit_the_features() -> None:
    weights = edge_weights()
    assert weights["stem.kernel"].shape[2] == 4 * FEATURES
    assert all(np.isfinite(array).all() for array in weights.values())
    assert 4 * sum(array.size for array in weights.values()) < 2_000_000


def test_brightness_of_photo_and_estimate_alone_change_nothing() -> None:
    photo, estimate = fields(16, 12)
    colors = jnp.stack([photo, photo - 0.3, photo + 0.1], axis=-1)
    normal, depth = jnp.zeros((16, 12, 3)), jnp.ones((16, 12))
    one = edge_features(colors, estimate, normal, depth)
    other = edge_features(colors + 0.7, estimate - 0.4, normal, depth)
    np.testing.assert_allclose(np.asarray(one), np.asarray(other), atol=1e-5)


def test_the_light_of_rooms_never_seen_comes_nearer() -> None:
    """Estimates that are blurred by a twentieth of the picture, on the true surface."""
    from scipy.ndimage import gaussian_filter

    after, before = [], []
    for number in range(2):
        room = make_random_room(UNSEEN_SEED, number)
        for view in range(3):
            shot = photograph(room, view, 160)
            hit = shot.depth > 0
            light = np.log(np.maximum(shot.light, 1e-6)).mean(axis=-1)
            light = np.where(hit, np.maximum(light, np.percentile(light, 2)), light[hit].mean())
            estimate = gaussian_filter(light, 8.0)
            photo = np.log(np.maximum(np.asarray(to_linear(jnp.asarray(shot.image))), LEAST_LIGHT))
            depth = np.where(hit, shot.depth, 1.0).astype(np.float32)
            arrays = (jnp.asarray(x, jnp.float32) for x in (photo, estimate, shot.normal, depth))
            shares = light_shares(edge_weights(), edge_features(*arrays))
            change = corrected(jnp.asarray(photo.mean(axis=-1)), jnp.asarray(estimate, jnp.float32), shares)
            valid = hit & (shot.image.max(axis=-1) < 0.98)
            after.append(np.sqrt(((estimate + np.asarray(change) - light)[valid] ** 2).mean()))
            before.append(np.sqrt(((estimate - light)[valid] ** 2).mean()))
    assert np.mean(after) < 0.95 * np.mean(before)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.open(
        SceneSettings(), capture=load_room(n_frames=6, width=96, height=72, quality=0.25, progress=False)
    )


def test_the_default_follows_light_edges_and_the_choice_leaves_them_out(scene: Scene) -> None:
    plain = Configuration().with_choices({"light_edges": False})
    sharp, blurred = (Relighter(scene, "center-point", c).relit(0) for c in (None, plain))
    change = np.asarray(sharp.relight_filter) / np.maximum(np.asarray(blurred.relight_filter), 1e-6)
    assert np.abs(np.log(np.maximum(change, 1e-3))).max() > 0.02
    np.testing.assert_allclose(change, change[..., :1].repeat(3, -1), rtol=2e-3)


def test_a_temporal_filter_that_changes_nothing_leaves_the_sharpened_picture(scene: Scene) -> None:
    relighter, seen = Relighter(scene, "center-point"), []

    def remember(illuminance: jax.Array, visibility: jax.Array) -> tuple[jax.Array, jax.Array]:
        seen.append(illuminance)
        return illuminance, visibility

    lit = relighter.lit(0)
    stages = dict(refine(lit, relighter.configuration))
    steadied = dict(refine(lit, relighter.configuration, temporal_filter=remember))
    np.testing.assert_allclose(steadied["composite"], stages["composite"], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(seen[0], sharpened(stages["cascade"], stages["light edges"]))


def test_a_photo_whose_own_sources_stay_on_is_left_alone(scene: Scene) -> None:
    name = scene.photo_light.estimate.names[0]
    kept = scene.lights("center-point")
    kept = type(kept)(kept.lights, kept.reference_lux, existing={name: (1.0, 1.0, 1.0)})
    assert Relighter(scene, kept).lit(0).light_edges is None
    assert Relighter(scene, "center-point").lit(0).light_edges is not None


@pytest.mark.parametrize(
    ("longest", "factor"), [(1, 1), (180, 1), (254, 1), (256, 2), (440, 2), (512, 3), (640, 4)]
)
def test_pictures_are_pooled_to_about_what_the_network_sees(longest: int, factor: int) -> None:
    assert _pooling(longest) == factor


def test_a_frame_larger_than_the_network_sees_is_pooled(scene: Scene) -> None:
    """Where each pixel is repeated, the network sees the picture as it was, and its cells keep the correction."""

    def repeated(x: jax.Array) -> jax.Array:
        return x.repeat(2, axis=0).repeat(2, axis=1)

    def twice(view: View) -> View:
        parts = jax.tree.map(repeated, (view.frame, view.display, view.gbuffer))
        return View(*parts, view.pose, view.intrinsics)

    def correction(view: View) -> np.ndarray:
        return np.asarray(edge_correction(view, jnp.ones(view.frame.shape), edge_weights()))

    small = twice(scene.view(0))
    large = twice(small)
    assert max(small.frame.shape) < 1.5 * LONGEST_SIDE < max(large.frame.shape) < 2.5 * LONGEST_SIDE
    cells = correction(large).reshape(144, 2, 192, 2).mean(axis=(1, 3))
    assert (
        float(np.quantile(np.abs(cells - correction(small)[..., 0]), 0.95)) < 0.02
    )  # but for interpolated borders


def test_the_gradient_is_that_of_finite_differences() -> None:
    with jax.enable_x64(True):
        photo, estimate = (jnp.asarray(np.asarray(x, np.float64)) for x in fields(6, 5))
        shares = tuple(
            jnp.asarray(np.random.default_rng(k).uniform(size=s)) for k, s in enumerate([(5, 5), (6, 4)])
        )

        def loss(e: jax.Array) -> jax.Array:
            return jnp.sum(jnp.sin(e + corrected(photo, e, shares)))  # type: ignore[arg-type]

        slope, step = jax.grad(loss)(estimate), 1e-6
        change = (loss(estimate.at[2, 3].add(step)) - loss(estimate.at[2, 3].add(-step))) / (2 * step)
    assert float(slope[2, 3]) == pytest.approx(float(change), rel=1e-6)


def test_pixels_that_are_not_finite_are_black_and_spoil_no_other(scene: Scene) -> None:
    view, light = scene.view(0), jnp.ones((72, 96, 3))
    broken, black = (dataclasses.replace(view, frame=view.frame.at[5, 7].set(x)) for x in (jnp.nan, 0.0))
    found, wanted = (np.asarray(edge_correction(v, light, edge_weights())) for v in (broken, black))
    np.testing.assert_array_equal(found, wanted)
    broken = dataclasses.replace(broken, display=view.display.at[5, 7].set(jnp.nan))
    assert np.isfinite(edge_correction(broken, light, edge_weights())).all()


def test_the_gradient_by_depth_is_finite(scene: Scene) -> None:
    view, light = scene.view(0), jnp.ones((72, 96, 3))

    def total(depth: jax.Array) -> jax.Array:
        buffer = dataclasses.replace(view.gbuffer, depth=depth)
        return edge_correction(dataclasses.replace(view, gbuffer=buffer), light, edge_weights()).sum()

    for depth in (view.gbuffer.depth, jnp.full((72, 96), 2.0)):
        assert np.isfinite(jax.grad(total)(depth)).all()


def test_a_view_without_a_pose_and_other_weights_are_refused(scene: Scene) -> None:
    view, light = scene.view(0), jnp.ones((72, 96, 3))
    with pytest.raises(InputError, match="need the view's pose"):
        edge_correction(dataclasses.replace(view, pose=None), light, edge_weights())
    with pytest.raises(InputError, match="not the weights of this network"):
        edge_correction(view, light, {"stem.kernel": jnp.zeros((3, 3, 4, 8))})
    for name, axis in (("block0.bias", 0), ("block1.kernel", 2)):
        with pytest.raises(InputError, match="not the weights of this network"):
            other = {name: edge_weights()[name].take(jnp.arange(3), axis)}
            edge_correction(view, light, edge_weights() | other)


def test_pages_and_tours_draw_without_and_do_not_say_so(caplog: pytest.LogCaptureFixture) -> None:
    for renderer in ("page", "tour", "webgpu"):
        assert not Configuration().followed_by(renderer).light.edges
        assert not Configuration.preset("quality").followed_by(renderer, say=False).light.edges
    assert not caplog.records
    assert Configuration().followed_by("frames").light.edges


def test_the_papers_form_takes_none(scene: Scene) -> None:
    view = scene.view(0)
    shaded = scene.shade(view, "center-point", keep_photo_light=True)
    with pytest.raises(InputError, match="leave light_edges out"):
        relight(view, shaded, view.display, "hyjax", mode="paper", light_edges=edge_weights())
