"""Vectors."""

import numpy as np
import pytest

from hyjax.util.vectors import orthonormal_frame


@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.6, 0.0, -0.8]])
def test_a_frame_is_right_handed_and_ends_in_its_direction(direction: list[float]) -> None:
    x, y, z = orthonormal_frame(direction)
    np.testing.assert_allclose(z, direction, atol=1e-12)
    np.testing.assert_allclose(np.cross(x, y), direction, atol=1e-12)
    assert np.linalg.norm(x) == pytest.approx(1.0)
