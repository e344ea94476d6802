"""ARKitScenes' `.pincam` files: one line `width height fx fy cx cy`, pixels."""

from pathlib import Path

from hyjax.data.capture_files import read_numbers
from hyjax.geometry.camera import Intrinsics
from hyjax.util.errors import InputError

COLUMNS = "width height fx fy cx cy"
NAME_TOLERANCE = 0.001 + 1e-6
"""Seconds by which the times in the names of a picture and of its `.pincam` may differ: one unit of the last of
three decimals, and what rounding adds to it."""


def read_intrinsics(path: Path) -> Intrinsics:
    """Read a `.pincam` file."""
    width, height, *focal_and_centre = (float(value) for value in read_numbers(path, (6,), COLUMNS))
    if not (width.is_integer() and height.is_integer()):
        raise InputError(f"{path}: picture size {width:g}x{height:g} is not whole; need {COLUMNS}")
    try:
        # cx, cy are taken as they are: Apple counts the principal point from the top left corner of the top left
        # pixel (documentation of AVCameraCalibrationData.intrinsicMatrix), as we do. The loader published with the
        # data has pixel centres at whole numbers instead; the two are half a pixel apart.
        return Intrinsics(int(width), int(height), *focal_and_centre)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
