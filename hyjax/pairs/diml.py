"""DIML/CVL RGB-D: indoor scenes from a Kinect v2, outdoor scenes from a stereo camera.

Four layouts are published; any folder above the ones that are named here can be given.

    SCENE/color/NAME_c.png       SCENE/depth_filled/NAME_depth_filled.png                  indoor, sample data
    SCENE/.../col/NAME_c.png     SCENE/.../up_png/NAME_ud.png                              indoor, whole data set
    outleft/NAME.png             depthmap/NAME.png             confidencemap/NAME.png      outdoor, sample data
    .../left/NAME_left.png       .../depth/NAME_depth.png      .../conf/NAME_conf.png      outdoor, whole data set

Depth is in 16-bit millimetres, confidence in 8 bits. The sample data come in HR and LR; give one of the two
folders, or every scene is there twice.

Source: Cho et al., "DIML/CVL RGB-D dataset: 2M RGB-D images of natural indoor and outdoor scenes", arXiv
2110.11590.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from hyjax.pairs.depth_pairs import PairsKind
from hyjax.pairs.files import FilePairs, Files, folders, matched, named
from hyjax.util.errors import InputError
from hyjax.util.images import read_depth, read_image

LEAST_CONFIDENCE = 0.9
"""Least confidence, of 1, from which outdoor depth counts."""


LAYOUTS = (
    {"color": "_c", "depth_filled": "_depth_filled"},
    {"col": "_c", "up_png": "_ud"},
    {"outleft": "", "depthmap": "", "confidencemap": ""},
    {"left": "_left", "depth": "_depth", "conf": "_conf"},
)
"""Layouts: the ending of the names in each subfolder, of pictures first."""


def open_diml(path: Path) -> FilePairs:
    """Open all scenes in a folder and below."""
    files: dict[str, Files] = {}
    for parent in folders(path):
        for layout in LAYOUTS:
            if all((parent / folder).is_dir() for folder in layout):
                found = matched(*(named(parent / folder, ending, (".png",)) for folder, ending in layout.items()))
                files |= {(parent.relative_to(path) / name).as_posix(): group for name, group in found.items()}
    if not files:
        known = "; ".join(" + ".join(layout) for layout in LAYOUTS)
        raise InputError(f"{path}: no DIML scene; looked for folders {known}")
    return FilePairs(path, "metres", files, _read)


def _read(rest: Files) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"] | None]:
    depth = read_depth(rest[0])
    if len(rest) == 1:
        return depth, None
    confidence = read_image(rest[1])[..., 0]
    if confidence.shape != depth.shape:
        raise InputError(
            f"{rest[1]}: {confidence.shape[1]}x{confidence.shape[0]} but the depth map is "
            f"{depth.shape[1]}x{depth.shape[0]}"
        )
    return depth, confidence > LEAST_CONFIDENCE


KIND = PairsKind("diml", lambda path, options: open_diml(path))
