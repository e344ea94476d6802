"""Parts of `experiments.truth`: the camera, the fit of gains, and paired intervals."""

import numpy as np
import pytest

from experiments.truth_camera import Exposed, camera_response, exposed_light, fit_gains
from experiments.truth_table import interval


def test_the_camera_can_be_undone() -> None:
    light = np.linspace(0, 1.5, 60, dtype=np.float32).reshape(4, 5, 3)
    np.testing.assert_allclose(exposed_light(camera_response(light)), light, atol=2e-3)


@pytest.mark.parametrize("response", [Exposed.response, camera_response])
def test_gains_are_found(response) -> None:  # type: ignore[no-untyped-def]
    light = np.random.default_rng(0).uniform(0, 0.4, (32, 40, 3)).astype(np.float32)
    picture = Exposed(light, response)
    truth = picture.display(np.array([0.3, 1.0, 1.9], np.float32))
    np.testing.assert_allclose(fit_gains(picture, truth), [0.3, 1.0, 1.9], rtol=0.01)


def test_intervals_draw_whole_clusters() -> None:
    values = np.array([1.0, 1.0, 1.0, 3.0, np.nan])
    mean, low, high = interval(values, ["a", "a", "a", "b", "b"])
    assert mean == 1.5 and (low, high) == (1.0, 3.0)
    assert np.isnan(interval(np.full(2, np.nan), ["a", "b"])).all()
