"""Features of a network carried from frame to frame: seldom made, the same on the same surface."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import pytest

from hyjax import InputError, View
from hyjax.geometry.camera import Camera
from hyjax.video import CarriedGuide
from tests.video.test_video import camera, painted, wall
from tests.video.test_video import view as matrices


def seen(cam: Camera) -> View:
    pose, intrinsics = matrices(cam)
    grey = jnp.full((*wall(cam).hit.shape, 3), 0.5)
    return View(grey, grey, wall(cam), pose, intrinsics)


def run(cameras: Sequence[Camera], every: int) -> tuple[list[np.ndarray], int]:
    """Features of a video, and how often they were made."""
    carried, made, found = CarriedGuide(every), [], []
    for cam in cameras:

        def make(cam: Camera = cam) -> object:
            made.append(cam)
            return painted(cam)

        found.append(np.asarray(carried.features(seen(cam), make)))  # type: ignore[arg-type]
    return found, len(made)


@pytest.mark.parametrize(("every", "times"), [(1, 9), (2, 5), (4, 3), (64, 1)])
def test_a_network_sees_one_frame_of_so_many(every: int, times: int) -> None:
    found, made = run([camera(0.02 * n) for n in range(9)], every)
    assert made == times
    for n, features in enumerate(found):
        error = np.abs(features - np.asarray(painted(camera(0.02 * n))))
        assert np.median(error) < 2e-3, "features stay on the surface"
        assert np.isfinite(features).all()


def test_features_start_anew_where_hardly_anything_is_found_again() -> None:
    _, made = run([camera(), camera(50.0), camera(50.0)], 8)
    assert made == 2


def test_a_view_without_its_camera_is_refused() -> None:
    grey = jnp.ones((4, 4, 3))
    flat = View(grey, grey, wall(camera()))
    with pytest.raises(InputError, match="pose and intrinsics"):
        CarriedGuide(2).features(flat, lambda: grey)
    with pytest.raises(InputError, match="1 or more"):
        CarriedGuide(0)
