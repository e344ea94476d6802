"""Any capture on disk → `Capture`, whichever of the known layouts it has."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from hyjax.data.arkit_scenes import holds_arkit_scenes, open_arkit_scenes
from hyjax.data.capture import Capture
from hyjax.data.kinect import registered
from hyjax.data.seven_scenes import holds_seven_scenes, open_seven_scenes
from hyjax.errors import InputError


@dataclasses.dataclass(frozen=True)
class Layout:
    """One way to store a capture: how to recognise it (by names alone), how to open it, its signs."""

    name: str
    recognise: Callable[[Path], bool]
    open: Callable[[Path], Capture]
    signs: str


LAYOUTS = (
    Layout("7-Scenes", holds_seven_scenes, open_seven_scenes, "frame-NNNNNN.color.jpg|png"),
    Layout("ARKitScenes", holds_arkit_scenes, open_arkit_scenes, "lowres_wide.traj, vga_wide/"),
)


def open_capture(path: Path) -> Capture:
    """Open the capture in folder `path`; the first layout that recognises it reads it.

    Where pictures and depth are from two cameras, they are registered (see `hyjax.data.kinect`).

    Raises:
        InputError: no such folder, no known layout, or what the layout's own reader finds wrong.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; give the folder of a capture")
    for layout in LAYOUTS:
        if layout.recognise(path):
            return registered(layout.open(path))
    known = "; ".join(f"{layout.name} ({layout.signs})" for layout in LAYOUTS)
    raise InputError(f"{path}: not a known capture layout; known are: {known}")
