"""What a guide is trained on: tinted depth, shading under random lamps, borders."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyjax.training.targets import (
    AMBIENT_SHARE,
    STRAIGHT_PIXELS,
    TINT,
    Sample,
    borders,
    random_shading,
    relative_depth,
    tinted_depth,
)

H, W = 24, 32


def flat(depth: np.ndarray, valid: np.ndarray | None = None, normal: np.ndarray | None = None) -> Sample:
    """A crop whose surface faces the camera unless told otherwise."""
    valid = np.ones(depth.shape, bool) if valid is None else valid
    normal = np.broadcast_to([0.0, 0.0, -1.0], (*depth.shape, 3)) if normal is None else normal
    arrays = (
        np.zeros((*depth.shape, 3)),
        np.where(valid, depth, 0.0),
        valid,
        np.where(valid[..., None], normal, 0.0),
    )
    return Sample(*(jnp.asarray(a, bool if a.dtype == bool else jnp.float32) for a in arrays))


def slanted() -> np.ndarray:
    """A plane at a steep angle: inverse depth is linear in the pixel."""
    return 1.0 / np.linspace(0.3, 1.2, W) * np.ones((H, 1))


@given(st.floats(0.1, 100.0))
def test_depth_is_relative_to_its_mean_whatever_the_unit(unit: float) -> None:
    depth = np.random.default_rng(0).uniform(1, 3, (H, W))
    valid = depth > 1.5
    expected = np.where(valid, depth / depth[valid].mean(), 1.0)
    np.testing.assert_allclose(relative_depth(flat(unit * depth, valid)), expected, rtol=1e-5)


def test_without_any_valid_pixel_everything_is_finite() -> None:
    nothing = flat(np.ones((H, W)), np.zeros((H, W), bool))
    for picture in (relative_depth(nothing), random_shading(nothing, jax.random.key(0))):
        assert np.isfinite(picture).all()
    assert not any(np.asarray(known).any() for known in borders(nothing)[1])


def test_tinted_depth_is_depth_times_three_factors() -> None:
    sample = flat(np.random.default_rng(1).uniform(1, 3, (H, W)))
    ratio = np.asarray(tinted_depth(sample, jax.random.key(3)) / relative_depth(sample)[..., None])
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0, 0], ratio.shape), rtol=1e-5)
    assert TINT[0] <= ratio.min() < ratio.max() <= TINT[1]
    assert not np.allclose(tinted_depth(sample, jax.random.key(4)), tinted_depth(sample, jax.random.key(3)))


def test_shading_is_ambient_where_normals_are_unknown_and_brighter_where_a_lamp_shines() -> None:
    unlit = flat(np.full((H, W), 2.0), normal=np.zeros((H, W, 3)))
    np.testing.assert_allclose(random_shading(unlit, jax.random.key(0)), AMBIENT_SHARE, rtol=1e-6)
    lit = np.asarray(random_shading(flat(np.full((H, W), 2.0)), jax.random.key(0)))
    assert lit.min() >= AMBIENT_SHARE - 1e-6
    assert lit.mean() > 2 * AMBIENT_SHARE
    assert np.ptp(lit, axis=2).max() > 0.01  # lamps are coloured


def test_shading_steps_at_a_crease_where_depth_does_not() -> None:
    normal = np.zeros((H, W, 3))
    normal[:, : W // 2], normal[:, W // 2 :] = (0.6, 0.0, -0.8), (-0.6, 0.0, -0.8)
    roof = flat(2.0 + 0.01 * np.abs(np.arange(W) - W / 2 + 0.5) * np.ones((H, 1)), normal=normal)
    steps = np.abs(np.diff(np.asarray(random_shading(roof, jax.random.key(2))).mean(axis=2), axis=1)).mean(axis=0)
    assert steps.argmax() == W // 2 - 1
    assert steps.max() > 3 * np.median(steps)


def test_a_depth_jump_is_a_border_and_a_slanted_plane_is_none() -> None:
    plane = slanted()
    (vertical, horizontal), _ = borders(flat(plane))
    assert not np.asarray(vertical).any() and not np.asarray(horizontal).any()
    stepped = np.where(np.arange(W) < 10, plane, plane + 0.3)
    (vertical, horizontal), (known, _) = borders(flat(stepped))
    assert np.asarray(horizontal)[:, 9].all()
    assert np.asarray(horizontal).sum() == H
    assert not np.asarray(vertical).any() and np.asarray(known).all()
    turned = borders(flat(stepped.T))[0]  # what holds across holds down
    np.testing.assert_array_equal(np.asarray(turned[0]), np.asarray(horizontal).T)


@pytest.mark.parametrize("degrees, is_border", [(8.0, False), (40.0, True)])
def test_a_crease_is_a_border_if_it_is_sharp(degrees: float, is_border: bool) -> None:
    angle = np.deg2rad(degrees / 2)
    normal = np.zeros((H, W, 3))
    normal[:12] = (0.0, np.sin(angle), -np.cos(angle))
    normal[12:] = (0.0, -np.sin(angle), -np.cos(angle))
    (vertical, horizontal), _ = borders(flat(np.full((H, W), 2.0), normal=normal))
    assert np.asarray(vertical)[11].all() == is_border
    assert np.asarray(vertical).sum() == W * is_border and not np.asarray(horizontal).any()


def test_nothing_is_known_beside_an_invalid_pixel() -> None:
    valid = np.ones((H, W), bool)
    valid[5, 7] = False
    (vertical, horizontal), (known_v, known_h) = borders(flat(np.full((H, W), 2.0), valid))
    assert not np.asarray(vertical).any() and not np.asarray(horizontal).any()
    assert not known_v[4:6, 7].any() and not known_h[5, 6:8].any()
    assert known_v.sum() == known_v.size - 2 and known_h.sum() == known_h.size - 2


def test_without_normals_borders_are_known_at_jumps_and_where_depth_goes_straight_on() -> None:
    depth = np.where(np.arange(W) < 10, 1.0, 2.0) * np.ones((H, 1))
    (vertical, horizontal), (known_v, known_h) = borders(flat(depth, normal=np.zeros((H, W, 3))))
    assert np.asarray(horizontal)[:, 9].all() and np.asarray(horizontal).sum() == H
    assert not np.asarray(vertical).any()
    across = [
        9,
        *range(10 + STRAIGHT_PIXELS, W - 1 - STRAIGHT_PIXELS),
    ]  # the jump, and what is far from it and from the margin
    np.testing.assert_array_equal(np.flatnonzero(np.asarray(known_h).all(axis=0)), across)
    assert np.asarray(known_h).sum() == H * len(across)
    np.testing.assert_array_equal(
        np.flatnonzero(np.asarray(known_v).all(axis=1)), range(STRAIGHT_PIXELS, H - 1 - STRAIGHT_PIXELS)
    )


@pytest.mark.parametrize("step, is_known", [(0.002, True), (0.01, False), (0.02, False), (0.028, False)])
def test_without_normals_a_small_step_is_no_border_for_sure_nor_none(step: float, is_known: bool) -> None:
    depth = np.where(np.arange(W) < W // 2, 1.0, 1.0 + step) * np.ones((H, 1))
    (_, horizontal), (_, known) = borders(flat(depth, normal=np.zeros((H, W, 3))))
    assert not np.asarray(horizontal).any()
    assert np.asarray(known)[:, W // 2 - 1].all() == is_known == np.asarray(known)[:, W // 2 - 1].any()


@pytest.mark.parametrize("degrees, focal, is_known", [(3.0, 450, True), (20.0, 585, False), (40.0, 450, False)])
def test_without_normals_depth_may_turn_where_it_bends(degrees: float, focal: float, is_known: bool) -> None:
    tilt = np.tan(np.deg2rad(degrees / 2)) / focal  # change of depth a pixel, in multiples of depth
    roof = 2.0 * (1.0 + tilt * np.abs(np.arange(W) - W / 2 + 0.5)) * np.ones((H, 1))
    (_, horizontal), (_, known) = borders(flat(roof, normal=np.zeros((H, W, 3))))
    assert not np.asarray(horizontal).any()
    assert np.asarray(known)[:, W // 2 - 1].all() == is_known == np.asarray(known)[:, W // 2 - 1].any()
