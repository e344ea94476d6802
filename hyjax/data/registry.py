"""Captures by folder: the formats that can be read, and the built-in room.

A new format is a file that ends with its `CaptureFormat` and a line in `CAPTURE_FORMATS`; or, outside the package,
a call of `register_format`.
"""

import logging
from pathlib import Path, PurePosixPath

from hyjax.data import (
    arkit_scenes,
    colmap,
    nerfstudio,
    polycam,
    record3d,
    redwood,
    scanner3d,
    scannet,
    seven_scenes,
    stray,
    tum,
)
from hyjax.data.capture import Capture, CaptureFormat
from hyjax.data.file_tree import FileTree
from hyjax.data.scaled import ScaledCapture
from hyjax.data.trees import open_tree
from hyjax.geometry.depth_sensor import PHONE_LIDAR, UNKNOWN
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError

CAPTURE_FORMATS = [
    seven_scenes.FORMAT,
    arkit_scenes.FORMAT,
    scanner3d.FORMAT,
    record3d.FORMAT,
    stray.FORMAT,
    polycam.FORMAT,
    nerfstudio.FORMAT,
    colmap.FORMAT,
    tum.FORMAT,
    scannet.FORMAT,
    redwood.FORMAT,
]
"""The formats of captures; the one that recognises a folder reads it."""
DEEPEST_FOLDER = 16
"""Folders in folders that a capture may lie in."""
MOST_FOLDERS = 100
"""Folders, at any depth, that are looked into to say which one is a capture."""
PICTURES = (*colmap.PICTURES, ".heic", ".webp")
"""Endings of pictures' names."""
MOST_NAMED = 6
"""Most captures in a folder that are named."""
PHONE_SHAPE = [192, 256]
"""Shape of a phone's depth maps, by which they are known in layouts that name no sensor."""
_log = logging.getLogger(__name__)


def register_format(entry: CaptureFormat) -> None:
    """Add a format to `CAPTURE_FORMATS`.

    Raises:
        InputError: there is one of this name.
    """
    if any(entry.name == known.name for known in CAPTURE_FORMATS):
        raise InputError(f"capture format {entry.name!r} is registered already; choose another name")
    CAPTURE_FORMATS.append(entry)


def known_formats() -> str:
    """The formats and their signs in one line."""
    return "; ".join(f"{entry.name} ({entry.signs})" for entry in CAPTURE_FORMATS)


@checked_arguments
def open_capture(
    path: Path | str | None = None,
    progress: bool = True,
    *,
    size: tuple[int, int] | None = None,
    scale: float | None = None,
    strict: bool = False,
) -> Capture:
    """Open a capture, whichever of `CAPTURE_FORMATS` it has; the built-in room by default.

    Args:
        path: a folder, a ZIP archive, an `.r3d` or a `.sens` file; None for the built-in room.
        progress: show a bar on stderr while the built-in room is rendered for the first time.
        size: (height, width) of the built-in room's pictures, up to `MOST_PIXELS`; others are as captured.
        scale: metres in one unit of the capture's poses, for those that do not know it.
        strict: refuse a capture of which anything is damaged, instead of leaving that out with a line.

    Raises:
        InputError: no such folder, no known format or several, or an error of the format's own reader.
    """
    if scale is not None and not 0 < scale < float("inf"):
        raise InputError(f"scale: must be > 0 metres, got {scale:g}")
    if path is None:
        from hyjax.data.builtin_room import load_room, rendered_size

        if scale is not None:
            raise InputError("scale: the built-in room is in metres already")
        height, width = rendered_size(size)
        return load_room(width=width, height=height, progress=progress, wait=False)
    tree = open_tree(Path(path))
    files, entry = detect_format(tree)
    capture = entry.open(files)
    for fault in capture.faults:
        if strict:
            raise InputError(f"{path}: {fault} (--strict)")
        _log.warning("%s: %s", path, fault)
    if scale is not None:
        unscaled = capture.source if isinstance(capture, ScaledCapture) else capture
        capture = ScaledCapture(unscaled, scale)
    elif not capture.metric:
        _log.warning("%s: its unit is not known, it is taken for metres; give --scale, metres in one unit", path)
    capture.format, capture.strict = entry.name, strict
    if capture.sensor == UNKNOWN and _depth_shape(capture) == PHONE_SHAPE:
        capture.sensor = PHONE_LIDAR
    return capture


def _depth_shape(capture: Capture) -> list[int] | None:
    """Short and long side of the first depth map; None without one that can be read."""
    try:
        return sorted(capture.depth_reading(0).depth.shape) if capture.depth_count else None
    except InputError:
        return None


def detect_format(tree: FileTree) -> tuple[FileTree, CaptureFormat]:
    """The format of a capture, and its files: those of the one folder that an archive holds.

    Raises:
        InputError: no format fits, or two do.
    """
    for _ in range(DEEPEST_FOLDER):
        if len(tree.folders()) != 1 or tree.below("") or _fitting(tree):
            break
        tree = tree.subtree(tree.folders()[0])
    fitting = _fitting(tree)
    if len(fitting) == 1:
        return tree, fitting[0]
    if fitting:
        names = " and ".join(f"{entry.name} ({entry.signs})" for entry in fitting)
        raise InputError(f"{tree.path}: looks like {names}; move the files of one of them elsewhere")
    above = {parent.as_posix() for name in tree.names for parent in PurePosixPath(name).parents}
    folders = sorted(above - {"."}, key=lambda folder: (folder.count("/"), folder))[:MOST_FOLDERS]
    inside = [f"{folder}/ ({inner[0].name})" for folder in folders if (inner := _fitting(tree.subtree(folder)))]
    if inside:
        some = ", ".join(inside[:MOST_NAMED]) + ", …" * (len(inside) > MOST_NAMED)
        raise InputError(
            f"{tree.path}: not a capture, but has {some}; give {'that' if len(inside) == 1 else 'one'}"
        )
    pictures = any(PurePosixPath(name).suffix.lower() in PICTURES for name in tree.names)
    poses = "pictures alone are none, poses and depth or a mesh belong to them (docs/own_data.md); " * pictures
    known = ", ".join(entry.name for entry in CAPTURE_FORMATS)
    raise InputError(
        f"{tree.path}: not a known capture layout; {poses}known are {known}; hyjax info lists the files of each"
    )


def _fitting(tree: FileTree) -> list[CaptureFormat]:
    return [entry for entry in CAPTURE_FORMATS if entry.recognise(tree)]
