"""Picture of real captures for the documentation: photos, and the same frames by lamps and by a low sun below.

Of those in `$HYJAX_DATA` whose licences let their pictures be shown: three scans by a phone, and two of
Middlebury's stereo pairs.
"""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

import hyjax
from experiments.readme_picture import beside_each_other
from experiments.real_bench import RealPlace, named_pairs
from experiments.records import ROOT
from hyjax.util.errors import InputError
from hyjax.util.images import resize, to_bytes

DATA = Path(os.environ.get("HYJAX_DATA", ROOT.parent / "shared" / "data"))
SCANS = {"scanner3d_chair": 8, "scanner3d_corridor": 12, "scanner3d_board": 10}
"""Folder → frame."""
PAIRS = ("Piano", "Djembe")
SETUPS = "evening-lamps", "golden-hour"
SIZE = 240, 320


def real_captures() -> UInt8[np.ndarray, "h w 3"]:
    """Photos in one row, and relit pictures in a row for each set-up.

    Raises:
        InputError: the captures are not there.
    """
    if not DATA.is_dir():
        raise InputError(f"{DATA}: no such folder; set HYJAX_DATA to that of the captures")
    pairs = named_pairs(DATA / "middlebury_relit", PAIRS)
    settings = {name: hyjax.SceneSettings(capture=DATA / name, size=f"{SIZE[1]}x{SIZE[0]}") for name in SCANS}
    scenes = [(hyjax.Scene.open(one), SCANS[name]) for name, one in settings.items()]
    scenes += [(RealPlace(pair, False, "true").scene, 0) for pair in pairs]
    photos = [cut(scene.frame(frame).image) for scene, frame in scenes]
    relit = [
        [cut(np.asarray(hyjax.to_display(scene.relit(frame, setup).image))) for scene, frame in scenes]
        for setup in SETUPS
    ]
    return to_bytes(beside_each_other([photos, *relit], SIZE[1]))


def cut(picture: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "height width 3"]:
    """The largest centred part of the shape, at the size."""
    height, width = picture.shape[:2]
    across = min(width, round(height * SIZE[1] / SIZE[0]))
    down = min(height, round(width * SIZE[0] / SIZE[1]))
    top, left = (height - down) // 2, (width - across) // 2
    return resize(picture[top : top + down, left : left + across], *SIZE)
