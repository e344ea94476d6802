"""Lens distortion, undone: pictures of a real lens → pictures of a pinhole with the same intrinsics.

Brown's model with up to six radial and two tangential coefficients (OpenCV's `OPENCV`, `FULL_OPENCV`,
`SIMPLE_RADIAL`, `RADIAL`), and OpenCV's fisheye model of four coefficients (Kannala & Brandt, PAMI 2006).

Source: OpenCV's documentation, "Camera Calibration and 3D Reconstruction" and "Fisheye camera model".
"""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float

from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError

BAND_PIXELS = 1 << 20
"""Pixels that are looked up at a time: their places take a hundred bytes each."""


@dataclasses.dataclass(frozen=True)
class Distortion:
    """Distortion of a lens.

    Attributes:
        model: Brown's, or OpenCV's fisheye.
        radial: k1 to at most k6; k1 to k4 of a fisheye.
        tangential: p1, p2 of Brown's model.
    """

    model: Literal["brown", "fisheye"] = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        most = 6 if self.model == "brown" else 4
        if len(self.radial) > most or not np.all(np.isfinite((*self.radial, *self.tangential))):
            raise InputError(f"lens distortion: need at most {most} finite radial coefficients, got {self.radial}")

    @property
    def is_none(self) -> bool:
        """Whether the lens is a pinhole."""
        return self.model == "brown" and not any((*self.radial, *self.tangential))

    def distort(
        self, x: Float[np.ndarray, "*s"], y: Float[np.ndarray, "*s"]
    ) -> tuple[Float[np.ndarray, "*s"], Float[np.ndarray, "*s"]]:
        """Place on the plane of unit depth where a point at (x, y) of it is seen."""
        k = (*self.radial, *(0.0,) * (6 - len(self.radial)))
        r2 = x * x + y * y
        if self.model == "fisheye":
            r = np.sqrt(r2)
            theta = np.arctan(r)
            t2 = theta * theta
            bent = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
            scale = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
            return x * scale, y * scale
        radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / (1 + r2 * (k[3] + r2 * (k[4] + r2 * k[5])))
        p1, p2 = self.tangential
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


def undistorted(
    image: Float[np.ndarray, "h w *c"], intrinsics: Intrinsics, distortion: Distortion, *, nearest: bool = False
) -> Float[np.ndarray, "h w *c"]:
    """The picture that a pinhole with the same intrinsics would have taken, by linear interpolation.

    Beyond the borders of the stored picture the nearest pixel goes on.

    Args:
        nearest: take the nearest pixel, as depth maps want it, and 0 beyond the borders.
    """
    if distortion.is_none:
        return image
    out = np.empty((intrinsics.height, intrinsics.width, *image.shape[2:]), image.dtype)
    rows = max(1, BAND_PIXELS // intrinsics.width)
    for top in range(0, intrinsics.height, rows):
        band = slice(top, min(top + rows, intrinsics.height))
        out[band] = _undistorted_rows(image, intrinsics, distortion, band, nearest)
    return out


def _undistorted_rows(
    image: Float[np.ndarray, "h w *c"], k: Intrinsics, distortion: Distortion, band: slice, nearest: bool
) -> Float[np.ndarray, "rows w *c"]:
    x = (np.arange(k.width) + 0.5 - k.cx) / k.fx
    y = (np.arange(band.start, band.stop) + 0.5 - k.cy) / k.fy
    column, row = distortion.distort(*np.broadcast_arrays(x[None, :], y[:, None]))
    where = np.stack([row * k.fy + k.cy - 0.5, column * k.fx + k.cx - 0.5])
    if nearest:
        rows, columns = np.round(np.clip(where, -1e6, 1e6)).astype(int)
        inside = (rows >= 0) & (rows < k.height) & (columns >= 0) & (columns < k.width)
        taken = image[np.clip(rows, 0, k.height - 1), np.clip(columns, 0, k.width - 1)]
        return np.where(inside.reshape(*inside.shape, *(1,) * (image.ndim - 2)), taken, image.dtype.type(0))
    from scipy import ndimage  # SciPy is slow to load

    layers = [
        ndimage.map_coordinates(image[..., channel], where, order=1, mode="nearest")
        for channel in range(image.shape[2])
    ]
    return np.stack(layers, axis=-1).astype(image.dtype)
