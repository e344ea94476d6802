"""Plain folder of pictures and metric depth maps of the same names.

    NAME_rgb.png|jpg + NAME_depth.png             side by side, or
    rgb/NAME.png|jpg + depth/NAME.png             in two subfolders

Depth maps have one 16-bit channel in millimetres unless said otherwise, 0 or 65535 where there is no reading."""

from pathlib import Path

from hyjax.pairs.depth_pairs import PairsKind
from hyjax.pairs.files import FilePairs, matched, named
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.images import read_depth

STEPS = {"millimetres": 0.001, "centimetres": 0.01, "metres": 1.0, "tenths": 0.0001, "fifths": 0.0002}
"""Metres per stored step, by name; tenths and fifths are of a millimetre (TUM's RGB-D has fifths)."""


def open_folder(path: Path, steps: str = "millimetres") -> FilePairs:
    """Open a folder of pairs."""
    if steps not in STEPS:
        hint = did_you_mean(steps, STEPS)
        raise InputError(f"{path}: depth in unknown unit {steps!r}{hint}; use one of {', '.join(STEPS)}")
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give a folder of pictures with depth")
    if (path / "rgb").is_dir() and (path / "depth").is_dir():
        files = matched(named(path / "rgb"), named(path / "depth"))
    else:
        files = matched(named(path, "_rgb"), named(path, "_depth"))
    if not files:
        raise InputError(f"{path}: no pairs; looked for NAME_rgb.png + NAME_depth.png, or rgb/NAME + depth/NAME")
    return FilePairs(path, "metres", files, lambda rest: (read_depth(rest[0], STEPS[steps]), None))


KIND = PairsKind("folder", lambda path, options: open_folder(path, options.get("unit", "millimetres")), ("unit",))
MOSD = PairsKind("mosd", lambda path, options: open_folder(path))
