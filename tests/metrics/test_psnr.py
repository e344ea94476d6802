"""Peak signal-to-noise ratio."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.differences import assert_gradients
from skimage.metrics import peak_signal_noise_ratio

from hyjax import InputError
from hyjax.metrics import psnr

pytestmark = pytest.mark.usefixtures("strict_ranks")

SIZES = [(1, 1, 3), (7, 5, 1), (12, 31, 3)]
sizes = st.sampled_from(SIZES)
seeds = st.integers(0, 2**31)


def pair(seed: int, size: tuple[int, int, int] = (12, 31, 3)) -> np.ndarray:
    return np.random.default_rng(seed).uniform(size=(2, *size)).astype(np.float32)


@given(sizes, seeds)
def test_psnr_is_skimages_and_symmetric(size: tuple[int, int, int], seed: int) -> None:
    image, reference = pair(seed, size)
    expected = peak_signal_noise_ratio(reference.astype(float), image.astype(float), data_range=1.0)
    np.testing.assert_allclose(psnr(image, reference), expected, rtol=1e-5)
    assert psnr(reference, image) == psnr(image, reference)


def test_a_tenth_off_is_20_db() -> None:
    assert psnr(np.full((4, 5, 3), 0.6), np.full((4, 5, 3), 0.5)) == pytest.approx(20.0, abs=1e-4)


@given(seeds)
def test_only_valid_pixels_count(seed: int) -> None:
    image, reference = pair(seed)
    valid = np.random.default_rng(seed).uniform(size=image.shape[:2]) < 0.3
    valid[0, 0] = True
    expected = peak_signal_noise_ratio(reference[valid].astype(float), image[valid].astype(float), data_range=1.0)
    value, slope = jax.value_and_grad(psnr)(image, reference, valid=valid)
    np.testing.assert_allclose(value, expected, rtol=1e-5)
    assert psnr(np.where(valid[..., None], image, 0.0), reference, valid=valid) == value
    assert np.all(np.asarray(slope)[~valid] == 0) and np.all(np.asarray(slope)[valid] != 0)


def test_more_noise_is_less() -> None:
    reference, noise = 0.25 + 0.5 * pair(0)
    values = [float(psnr(reference + s * (noise - 0.5), reference)) for s in (0.0, 0.01, 0.1, 0.3, 1.0)]
    assert values[0] == np.inf and np.all(np.diff(values) < 0)


def test_equal_pictures_have_no_slope() -> None:
    image, _ = pair(0)
    value, slope = jax.value_and_grad(psnr)(image, image)
    assert value == np.inf and np.all(np.asarray(slope) == 0)


def test_gradient() -> None:
    with jax.enable_x64(True):
        assert_gradients(psnr, *pair(1, (4, 5, 3)).astype(np.float64))


def test_vmap() -> None:
    images, references = (np.stack([pair(seed)[k] for seed in range(3)]) for k in (0, 1))
    batch = jax.jit(jax.vmap(psnr))(images, references)
    np.testing.assert_allclose(batch, [psnr(a, b) for a, b in zip(images, references)], rtol=1e-6)


def test_no_valid_pixel_in_a_trace_is_nan() -> None:
    image, reference = pair(0)
    assert np.isnan(jax.jit(lambda v: psnr(image, reference, valid=v))(np.zeros(image.shape[:2], bool)))


GOOD = np.full((12, 14, 3), 0.5, np.float32)


def spoilt(value: float) -> np.ndarray:
    return np.where(np.arange(3) == 1, np.float32(value), GOOD)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (spoilt(1.01), r"image: display values must lie in \[0, 1\], got 0.5 to 1.01"),
        (spoilt(-0.01), r"image: display values must lie in \[0, 1\], got -0.01 to 0.5"),
        (spoilt(np.inf), r"image: display values must lie in \[0, 1\], got 0.5 to inf"),
        (spoilt(np.nan), r"image: has values that are not numbers"),
        (GOOD[1:], r"reference: .* got float32 of shape \(\d+, 14, 3\); h is \d+ by image"),
        (GOOD[..., :1], r"c is \d by image"),
        (GOOD[..., 0], r"image: must be a float array of shape h x w x c, got float32 of shape \(12, 14\)"),
        (GOOD[:0], r"^(image: is empty|reference: .* h is 12)"),
        ((255 * GOOD).astype(np.uint16), "image: must be a float array .*, got uint16 of shape"),
    ],
)
def test_bad_pictures(image: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        psnr(image, GOOD)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=message.replace("image: ", "reference: ").split(" got image")[0]):
        psnr(GOOD, jnp.asarray(image))


def test_round_off_is_let_through() -> None:
    assert np.isfinite(psnr(spoilt(1.00005), GOOD)) and np.isfinite(psnr(spoilt(-0.00005), GOOD))


@pytest.mark.parametrize(
    ("valid", "message"),
    [
        (
            np.ones((14, 12), bool),
            r"valid: .*, got bool of shape \(14, 12\); h is 12 by image",
        ),
        (np.ones((12, 14)), "valid: must be a bool array .*, got float32"),
        (np.zeros((12, 14), bool), "valid: no pixel is valid"),
    ],
)
def test_bad_masks(valid: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        psnr(GOOD, GOOD, valid=valid)
    assert "\n" not in str(caught.value)
