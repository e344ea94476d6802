"""Middlebury stereo: pictures with *disparity*, in the layouts of 2003, 2005, 2006 and 2014.

    SCENE/im2.png    SCENE/disp2.png     and im6, disp6                            2003
    SCENE/view1.png  SCENE/disp1.png     and view5, disp5;  SCENE/dmin.txt         2005, 2006
    SCENE/im0.png    SCENE/disp0.pfm     and im1, disp1;    SCENE/calib.txt        2014, 2021
    NAME_rgb.png     NAME_disparity.png                                            a plain folder

Eight-bit disparities are taken as they are stored, 0 being unknown; a PFM holds infinity there. Disparity is made
inversely proportional to depth where the scene says how: `dmin` was cut off both pictures, and `doffs` is how far
the principal points are apart. It has no other scale than the file's.

Source: vision.middlebury.edu/stereo/data; Scharstein et al., "High-resolution stereo datasets with
subpixel-accurate ground truth", GCPR 2014.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from hyjax.pairs.depth_pairs import PairsKind
from hyjax.pairs.files import PICTURES, FilePairs, Files, folders, matched, named
from hyjax.util.errors import InputError, shown
from hyjax.util.images import read_image
from hyjax.util.pfm import read_pfm
from hyjax.util.reading import finite, read_bytes

VIEWS = {"disp0": ("im0",), "disp1": ("view1", "im1"), "disp2": ("im2",), "disp5": ("view5",), "disp6": ("im6",)}
"""Names of the picture of each disparity map."""
LARGEST_CALIBRATION = 1 << 16
"""Largest size of a calibration file, in bytes."""
LARGEST_OFFSET = 1e6
"""Largest offset of disparities, in pixels."""


def open_middlebury(path: Path) -> FilePairs:
    """Open all scenes in a folder and below, every view with a disparity."""
    scenes = folders(path)
    files = matched(named(path, "_rgb"), named(path, "_disparity"))
    for scene in scenes:
        for stem, views in VIEWS.items():
            disparity = _first(scene / f"{stem}{suffix}" for suffix in (".pfm", ".png", ".pgm"))
            if disparity is None:
                continue
            picture = _first(scene / f"{view}{suffix}" for view in views for suffix in PICTURES)
            if picture is None:
                wanted = " or ".join(f"{view}.png" for view in views)
                raise InputError(f"{disparity}: has no picture {wanted} in its folder; add it or remove this file")
            files[(scene.relative_to(path) / picture.stem).as_posix()] = (picture, disparity)
    if not files:
        known = "view1.png + disp1.png, im0.png + disp0.pfm and such"
        raise InputError(f"{path}: no Middlebury scene; looked for {known}")
    return FilePairs(path, "disparity", files, _read)


def _first(files: Iterable[Path]) -> Path | None:
    """First existing file."""
    return next((file for file in files if file.is_file()), None)


def _read(rest: Files) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"] | None]:
    file = rest[0]
    if file.suffix.lower() == ".pfm":
        disparity = read_pfm(file)
    else:
        levels = read_image(file)
        if levels.shape[2] != 1:
            raise InputError(f"{file}: a disparity map has one channel, this picture has {levels.shape[2]}")
        disparity = np.round(levels[..., 0] * 255)
    known = np.isfinite(disparity) & (disparity > 0)
    return np.where(known, np.where(known, disparity, 0.0) + _offset(file.parent), 0.0), known


def _offset(scene: Path) -> float:
    """Pixels to add to a scene's stored disparities."""
    for name, pattern in (("dmin.txt", r"^\s*(\S+)"), ("calib.txt", r"^doffs=(\S+)")):
        file = scene / name
        if file.is_file():
            match = re.search(
                pattern, read_bytes(file, most=LARGEST_CALIBRATION).decode("utf-8", errors="replace"), re.MULTILINE
            )
            text = match[1] if match else "0"
            try:
                return finite(float(text), str(file), least=-LARGEST_OFFSET, most=LARGEST_OFFSET)
            except ValueError:
                raise InputError(f"{file}: need a number of pixels, got {shown(text)}") from None
    return 0.0


KIND = PairsKind("middlebury", lambda path, options: open_middlebury(path))
