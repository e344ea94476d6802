"""Gains between two pictures: those that were put in come out."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hyjax.metrics.exposure import LARGEST_GAIN, fit_gains
from hyjax.synthetic.tone_curve import encode

LIGHT = np.random.default_rng(0).uniform(0.02, 0.2, (24, 32, 3)).astype(np.float32)


@given(st.tuples(*[st.floats(0.2, 4.0)] * 3))
def test_gains_are_recovered(gains: tuple[float, float, float]) -> None:
    reference = encode(LIGHT * np.array(gains, np.float32))
    np.testing.assert_allclose(fit_gains(LIGHT, reference, encode), gains, rtol=0.02)


def test_only_what_is_valid_counts() -> None:
    reference = encode(2 * LIGHT)
    valid = np.zeros(LIGHT.shape[:2], bool)
    valid[:12] = True
    spoiled = np.where(valid[..., None], reference, 1.0)
    np.testing.assert_allclose(fit_gains(LIGHT, spoiled, encode, valid=valid), 2, rtol=0.02)
    assert np.abs(fit_gains(LIGHT, spoiled, encode) - 2).max() > 0.5
    assert (fit_gains(LIGHT, reference, encode, valid=np.zeros_like(valid)) == 1).all()


@pytest.mark.parametrize(("factor", "gain"), [(100.0, LARGEST_GAIN), (0.001, 1 / LARGEST_GAIN)])
def test_gains_are_bounded(factor: float, gain: float) -> None:
    found = fit_gains(LIGHT, np.sqrt(factor * LIGHT), np.sqrt)
    np.testing.assert_allclose(found, gain, rtol=1e-5)
