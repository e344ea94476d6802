"""Lens distortion against OpenCV. Its pixel centres are at whole numbers, ours at halves."""

import numpy as np
import pytest
import small_capture as small
from extras import need

from hyjax.data import lens
from hyjax.data.lens import Distortion, undistorted
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError

LENS = Intrinsics(160, 120, 110.0, 108.0, 79.0, 61.0)


def opencv_matrix() -> np.ndarray:
    k = LENS.matrix.copy()
    k[:2, 2] -= 0.5
    return k


def inner(image: np.ndarray) -> np.ndarray:
    return image[12:-12, 12:-12]


@pytest.mark.parametrize(
    ("radial", "tangential"),
    [
        ((0.1,), (0.0, 0.0)),
        ((-0.2, 0.05), (0.003, -0.002)),
        ((0.26, -0.95, 1.16), (-0.005, 0.003)),
        ((0.3, -0.1, 0.02, 0.25, -0.05, 0.01), (0.001, 0.001)),
    ],
)
def test_browns_model_is_opencvs(radial: tuple[float, ...], tangential: tuple[float, float]) -> None:
    need("experiments")
    import cv2

    image = small.picture(0, LENS)
    ours = undistorted(image, LENS, Distortion("brown", radial, tangential))
    k = [*radial, *(0.0,) * (6 - len(radial))]
    coefficients = np.array([k[0], k[1], *tangential, *k[2:]])
    theirs = cv2.undistort(image, opencv_matrix(), coefficients)
    np.testing.assert_allclose(inner(ours), inner(theirs), atol=0.01)


@pytest.mark.parametrize("radial", [(0.1, 0.0, 0.0, 0.0), (-0.05, 0.02, -0.01, 0.003)])
def test_the_fisheye_is_opencvs(radial: tuple[float, ...]) -> None:
    need("experiments")
    import cv2

    image = small.picture(0, LENS)
    ours = undistorted(image, LENS, Distortion("fisheye", radial))
    k = opencv_matrix()
    theirs = cv2.fisheye.undistortImage(image, k, np.array(radial), Knew=k)
    np.testing.assert_allclose(inner(ours), inner(theirs), atol=0.01)


def test_depth_takes_the_nearest_pixel_and_nothing_beyond_the_borders() -> None:
    depth = small.depth(0, LENS)
    straight = undistorted(depth, LENS, Distortion("brown", (0.4,)), nearest=True)
    assert set(np.unique(straight)) <= {0.0, *np.unique(depth)}
    assert straight[0, -1] == 0 and straight[61, 79] == depth[61, 79]


def test_a_pinhole_keeps_its_picture() -> None:
    image = small.picture(0, LENS)
    assert undistorted(image, LENS, Distortion()) is image


def test_coefficients_must_be_finite_and_few() -> None:
    with pytest.raises(InputError, match="lens distortion"):
        Distortion("brown", (float("nan"),))
    with pytest.raises(InputError, match="at most 4"):
        Distortion("fisheye", (0.1,) * 5)


@pytest.mark.parametrize("nearest", [False, True])
def test_rows_that_are_looked_up_in_turn_are_those_of_the_whole(
    nearest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once, a picture of 64 million pixels took 5 GiB."""
    image = np.random.default_rng(0).random((23, 31, 3)).astype(np.float32)
    intrinsics, bent = Intrinsics(31, 23, 20.0, 21.0, 15.0, 11.0), Distortion(radial=(0.1, -0.02))
    whole = lens.undistorted(image, intrinsics, bent, nearest=nearest)
    monkeypatch.setattr(lens, "BAND_PIXELS", 100)
    np.testing.assert_array_equal(lens.undistorted(image, intrinsics, bent, nearest=nearest), whole)
