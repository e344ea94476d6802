"""Structural similarity, against scikit-image's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.differences import assert_gradients
from skimage.metrics import structural_similarity

from hyjax import InputError
from hyjax.metrics import ssim, ssim_map

pytestmark = pytest.mark.usefixtures("strict_ranks")

SIZES = [(11, 11, 1), (13, 40, 3), (33, 24, 3)]
sizes = st.sampled_from(SIZES)
seeds = st.integers(0, 2**31)


def pair(seed: int, size: tuple[int, int, int] = (33, 24, 3)) -> tuple[np.ndarray, np.ndarray]:
    """A picture of smooth and of flat parts, and the same with noise of some strength."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1], : size[2]][:2]
    image = np.where(x < size[1] / 2, 0.5 + 0.4 * np.sin(0.3 * x + 0.2 * y), rng.uniform())
    noisy = image + rng.uniform(0.0, 0.5) * rng.normal(size=size)
    return image.astype(np.float32), noisy.clip(0.0, 1.0).astype(np.float32)


def skimages(image: np.ndarray, reference: np.ndarray) -> tuple[float, np.ndarray]:
    mean, similarity = structural_similarity(
        reference.astype(np.float64),
        image.astype(np.float64),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    return mean, similarity.mean(axis=-1)


@given(sizes, seeds)
def test_ssim_is_skimages_and_symmetric(size: tuple[int, int, int], seed: int) -> None:
    image, reference = pair(seed, size)
    mean, similarity = skimages(image, reference)
    np.testing.assert_allclose(ssim_map(image, reference), similarity, atol=1e-4)
    np.testing.assert_allclose(ssim(image, reference), mean, atol=1e-5)
    np.testing.assert_allclose(ssim(reference, image), ssim(image, reference), atol=1e-5)


def test_in_float64_to_the_last_digits() -> None:
    with jax.enable_x64(True):
        image, reference = (jnp.asarray(p, jnp.float64) for p in pair(5))
        mean, similarity = skimages(np.asarray(image), np.asarray(reference))
        np.testing.assert_allclose(ssim_map(image, reference), similarity, atol=1e-12)
        np.testing.assert_allclose(ssim(image, reference), mean, atol=1e-12)


def test_flat_pictures() -> None:
    """Only the first factor of Eq. 13 is left."""
    a, b = 0.2, 0.7
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    similarity = ssim_map(np.full((12, 15, 3), a, np.float32), np.full((12, 15, 3), b, np.float32))
    np.testing.assert_allclose(similarity, expected, atol=1e-4)


@given(seeds)
def test_equal_pictures_are_1_and_others_less(seed: int) -> None:
    image, other = pair(seed)
    assert ssim(image, image) == pytest.approx(1.0, abs=1e-5)
    assert ssim(image, other) < 1.0 - 1e-5


def test_more_noise_is_less() -> None:
    image, _ = pair(2)
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, image.shape).astype(np.float32)
    values = [float(ssim((image + s * noise).clip(0, 1), image)) for s in (0.0, 0.01, 0.05, 0.2, 0.6)]
    assert np.all(np.diff(values) < 0)


jitted = jax.jit(ssim)


@given(seeds)
def test_valid_pixels_away_from_the_border_count(seed: int) -> None:
    image, reference = pair(seed)
    similarity = np.asarray(ssim_map(image, reference))
    inner = np.s_[5:-5, 5:-5]
    np.testing.assert_allclose(
        ssim(image, reference, valid=np.ones((33, 24), bool)), ssim(image, reference), rtol=1e-6
    )
    valid = np.random.default_rng(seed).uniform(size=(33, 24)) < 0.3
    valid[6, 6] = True
    found = ssim(image, reference, valid=valid)
    np.testing.assert_allclose(found, similarity[inner][valid[inner]].mean(), atol=1e-5)
    np.testing.assert_allclose(jitted(image, reference, valid=valid), found, atol=1e-5)


def test_reach_of_the_window() -> None:
    """A changed pixel is felt within five pixels, and not beyond."""
    image, reference = pair(3)
    image = image.copy()
    before = np.asarray(ssim_map(image, reference))
    image[16, 12] = 1.0 - image[16, 12]
    changed = np.asarray(ssim_map(image, reference)) != before
    rows, columns = np.nonzero(changed)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (11, 21, 7, 17)


def test_gradient() -> None:
    """Of the mean over some pixels and, as far as the border, of the map."""
    rng = np.random.default_rng(0)
    valid, weights = rng.uniform(size=(12, 13)) < 0.7, rng.uniform(size=(12, 13))
    with jax.enable_x64(True):
        assert_gradients(
            lambda a, b: ssim(a, b, valid=valid) + jnp.mean(weights * ssim_map(a, b)),
            *(p.astype(np.float64) for p in pair(1, (12, 13, 2))),
        )


def test_equal_pictures_have_no_slope() -> None:
    image, _ = pair(1)
    np.testing.assert_allclose(jax.grad(ssim)(image, image), 0.0, atol=1e-6)


def test_vmap() -> None:
    images, references = (np.stack([pair(seed)[k] for seed in range(3)]) for k in (0, 1))
    single = [ssim(a, b) for a, b in zip(images, references)]
    np.testing.assert_allclose(jax.jit(jax.vmap(ssim))(images, references), single, rtol=1e-5)


GOOD = np.full((12, 14, 3), 0.5, np.float32)
BORDER = np.pad(np.zeros((2, 4), bool), 5, constant_values=True)


@pytest.mark.parametrize(
    ("image", "reference", "valid", "message"),
    [
        (GOOD + 1, GOOD, None, r"image: display values must lie in \[0, 1\], got 1.5 to 1.5"),
        (GOOD, GOOD * np.nan, None, "reference: has values that are not numbers"),
        (GOOD[1:], GOOD, None, "h is 11 by image"),
        (GOOD[:10], GOOD[:10], None, "image: must be at least 11 x 11 pixels, got 10 x 14"),
        (GOOD, GOOD, BORDER, "valid: no pixel, 5 pixels or more from the border, is valid"),
        (GOOD, GOOD, BORDER[1:], r"must be a bool array of shape h x w or None, got bool of shape \(11, 14\)"),
    ],
)
def test_bad_input(image: np.ndarray, reference: np.ndarray, valid: np.ndarray | None, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        ssim(image, reference, valid=valid)
    assert "\n" not in str(caught.value)
    if valid is None:
        with pytest.raises(InputError, match=message):
            ssim_map(image, reference)


def test_small_pictures_are_refused_in_a_trace() -> None:
    with pytest.raises(InputError, match="at least 11 x 11"):
        jitted(GOOD[:10], GOOD[:10])
