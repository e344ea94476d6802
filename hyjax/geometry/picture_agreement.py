"""Agreement of posed pictures: one is seen through another's depth map, and their fine grey structure compared.

The depth sensor says where a pixel of one picture lies in the next; a wrong pose shows there another place. No mesh
takes part, so that poses can be judged which a mesh was made to fit. Shading and exposure are left out by comparing
what is finer than a few pixels alone.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import DepthReading, clean_depth, confirmed_by

COARSE_PIXELS = 4.0
"""Standard deviation of the Gaussian, in pixels of the picture, that is taken off it."""
FEWEST_POINTS = 500
"""Fewest common points of two pictures for their agreement to be known."""
LEAST_CONTRAST = 1e-3
"""Least standard deviation of the fine structure of common points for their agreement to be known."""


class PosedPicture(NamedTuple):
    """A picture with the depth map of its moment.

    Attributes:
        fine: fine structure of its grey values, see `fine_structure`.
        reading: depth map; its camera has the pose of the picture's.
        depth: of the map where it is that of a single surface and near enough, see `clean_depth`; else 0.
    """

    fine: Float[np.ndarray, "h w"]
    camera: Camera
    reading: DepthReading
    depth: Float[np.ndarray, "dh dw"]

    def moved(self, pose: Float[np.ndarray, "4 4"]) -> "PosedPicture":
        """The same with another pose."""
        reading = self.reading._replace(camera=Camera(self.reading.camera.intrinsics, pose))
        return self._replace(camera=Camera(self.camera.intrinsics, pose), reading=reading)


def posed_picture(
    image: Float[np.ndarray, "h w 3"], camera: Camera, reading: DepthReading, far: float
) -> PosedPicture:
    """Picture with the depth map of its moment.

    Args:
        far: metres beyond which no reading counts.
    """
    depth = clean_depth(reading.depth, reading.camera, far)
    if reading.confidence is not None:
        depth[~(reading.confidence > 0)] = 0.0
    return PosedPicture(fine_structure(image), camera, reading, depth)


def fine_structure(image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """Grey values of a picture less their smooth part."""
    from scipy import ndimage  # SciPy is slow to load

    grey = image.mean(axis=-1)
    return grey - ndimage.gaussian_filter(grey, COARSE_PIXELS)


def agreement(first: PosedPicture, second: PosedPicture) -> float | None:
    """Correlation of the fine structure of two pictures where both see one surface; None where little is common.

    Args:
        second: what it sees in front of that surface hides it.
    """
    points = first.reading.camera.unproject(first.depth)[first.depth > 0]
    own, inside = _sampled(first, points)
    other, seen = _sampled(second, points)
    common = inside & seen & confirmed_by(second.reading.depth, second.reading.camera, points, unread=False)
    if common.sum() < FEWEST_POINTS or min(own[common].std(), other[common].std()) < LEAST_CONTRAST:
        return None
    return float(np.corrcoef(own[common], other[common])[0, 1])


def _sampled(
    picture: PosedPicture, points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Fine structure of a picture at world points, and which of them lie in it."""
    from scipy import ndimage  # SciPy is slow to load

    pixel, depth = picture.camera.project(points)
    (height, width), (x, y) = picture.fine.shape, np.nan_to_num(pixel.T - 0.5)
    inside = (depth > 0) & (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    return ndimage.map_coordinates(picture.fine, [y, x], order=1, mode="nearest"), inside
