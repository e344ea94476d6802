"""Geometry of a browser's screen: the picture in its background, rays through it, and its camera."""

import math

import numpy as np
import viser
import viser.transforms
from jaxtyping import Float, UInt8

from hyjax.geometry.camera import Camera

MARGIN = 22  # grey level beside the picture


def wipe_photo(
    photo: UInt8[np.ndarray, "h w 3"], picture: UInt8[np.ndarray, "h w 3"], share: float
) -> UInt8[np.ndarray, "h w 3"]:
    """The photo over the left `share` of the picture, with a line where they meet."""
    column = round(float(np.clip(share, 0.0, 1.0)) * picture.shape[1])
    if column == 0:
        return picture
    both = picture.copy()
    both[:, :column] = photo[:, :column]
    if column < picture.shape[1]:
        both[:, max(0, column - 1) : column + 1] = 255
    return both


def safe_aspect(camera: viser.CameraHandle) -> float:
    """Width of a browser's scene over its height, in 0.2 to 5."""
    try:
        aspect = float(camera.aspect)
    except ZeroDivisionError:
        aspect = 1.0
    return min(max(aspect, 0.2), 5.0) if math.isfinite(aspect) else 1.0


def background_size(camera: Camera, aspect: float) -> tuple[int, int, float]:
    """Height and width of the picture of `pad_to_aspect`, and its vertical angle of view in radians."""
    k = camera.intrinsics
    height = k.height if aspect * k.height >= k.width else round(k.width / aspect)
    return height, round(height * aspect), 2.0 * float(np.arctan(0.5 * height / k.fy))


def pad_to_aspect(picture: UInt8[np.ndarray, "h w 3"], camera: Camera, aspect: float) -> UInt8[np.ndarray, "H W 3"]:
    """A camera's picture, padded to the proportions of the browser's scene.

    The camera's principal point comes to the middle, so that a browser's camera, which always looks through the
    middle, sees the world where the picture shows it.
    """
    h, w = picture.shape[:2]
    k = camera.intrinsics
    height, width, _ = background_size(camera, aspect)
    top, left = round(0.5 * height - k.cy), round(0.5 * width - k.cx)
    padded = np.full((height, width, 3), MARGIN, np.uint8)
    y0, x0 = max(top, 0), max(left, 0)
    y1, x1 = min(top + h, height), min(left + w, width)
    padded[y0:y1, x0:x1] = picture[y0 - top : y1 - top, x0 - left : x1 - left]
    return padded


def screen_rays(
    screen: Float[np.ndarray, "n 2"], wxyz: Float[np.ndarray, "4"], angle: float, aspect: float
) -> Float[np.ndarray, "n 3"]:
    """World directions through points of a browser's scene.

    Args:
        screen: from 0 to 1, to the right and down.
        wxyz: rotation of its camera; z looks forward, y down.
        angle: vertical angle of view, radians.
        aspect: width of the scene over its height.
    """
    x, y = np.tan(0.5 * angle) * (2.0 * np.asarray(screen, float) - 1.0).T
    rays = np.stack([aspect * x, y, np.ones_like(x)], axis=-1)
    return rays @ viser.transforms.SO3(wxyz).as_matrix().T


def quaternion(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4"]:
    """Rotation of a pose as w, x, y, z."""
    wxyz: np.ndarray = viser.transforms.SO3.from_matrix(np.asarray(pose)[:3, :3]).wxyz
    return wxyz
