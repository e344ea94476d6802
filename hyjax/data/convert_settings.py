"""Settings of `hyjax convert`."""

import dataclasses
from pathlib import Path
from typing import Literal

import tyro

from hyjax.util.settings import Settings

Layout = Literal["7scenes", "nerfstudio", "arkit", "stray"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ConvertSettings(Settings):
    """Write a capture, or the built-in room, in another layout."""

    capture: tyro.conf.Positional[Path | None] = None
    """Folder or archive of a capture, in one of the formats that `hyjax info` lists. Default: the built-in room."""
    to: Layout
    """7scenes: one lens, depth registered to the pictures. nerfstudio: transforms.json. arkit: a raw scan of
    ARKitScenes, with confidences and the device's mesh. stray: a recording of Stray Scanner."""
    out: Path = Path("converted")
    """Folder for the result, which must not be there or be empty."""
    frames: str = "all"
    """Which frames, by position in the capture: all, 7, 0:300:30, or a list such as 0,5,9:12."""
    size: str | None = None
    """Size of the pictures: 512 (square) or 640x480 (width x height), of the largest centred part of that shape.
    Default: as captured."""
    scale: float | None = None
    """Metres in one unit of the capture's poses, for a capture that does not know it (COLMAP)."""
    strict: bool = False
    """Stop at the first damaged picture of a capture instead of leaving it out with a line."""
    quiet: bool = False
    """No progress on the terminal."""
