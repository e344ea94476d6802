"""Screen: the picture in the background, and rays through it."""

import numpy as np
import pytest
from extras import need

need("tour")

from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.tour.screen import background_size, pad_to_aspect, quaternion, screen_rays, wipe_photo

UP = np.array([0.0, 0.0, 1.0])
CAMERA = Camera(
    Intrinsics(160, 120, 130.0, 130.0, 79.0, 61.0), look_at(np.array([1.0, -2.0, 1.5]), np.zeros(3), UP)
)


def test_a_wipe_shows_the_photo_on_the_left() -> None:
    photo, relit = np.full((4, 10, 3), 50, np.uint8), np.full((4, 10, 3), 200, np.uint8)
    assert (wipe_photo(photo, relit, 0.0) == relit).all() and (
        wipe_photo(photo, relit, 1.0)[:, :9] == photo[:, :9]
    ).all()
    half = wipe_photo(photo, relit, 0.5)
    assert (half[:, :4] == 50).all() and (half[:, 6:] == 200).all() and (half[:, 4:6] == 255).all()


@pytest.mark.parametrize("aspect", [0.5, 1.0, 4 / 3, 3.0])
def test_a_picture_is_framed_whole(aspect: float) -> None:
    framed = pad_to_aspect(np.full((120, 160, 3), 200, np.uint8), CAMERA, aspect)
    assert framed.shape[1] / framed.shape[0] == pytest.approx(aspect, rel=0.02)
    assert (framed == 200).all(axis=-1).sum() >= 0.98 * 120 * 160


@pytest.mark.parametrize("aspect", [0.5, 4 / 3, 3.0])
def test_rays_through_the_scene_are_those_of_the_camera(aspect: float) -> None:
    height, width, angle = background_size(CAMERA, aspect)
    k = CAMERA.intrinsics
    pixels = np.array([(3.5, 4.5), (100.5, 7.5), (80.5, 110.5)])
    screen = 0.5 + (pixels - (k.cx, k.cy)) / (width, height)
    found = screen_rays(screen, quaternion(CAMERA.pose), angle, width / height)
    columns, rows = pixels.astype(int).T
    expected = CAMERA.rays()[rows, columns]
    np.testing.assert_allclose(found, expected / (expected @ CAMERA.pose[:3, 2])[:, None], atol=1e-5)
