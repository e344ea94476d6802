"""Captures by folder: the formats that can be read, and the built-in room.

A new format is a file that ends with its `CaptureFormat` and a line in `CAPTURE_FORMATS`; or, outside the package,
a call of `register_format`.
"""

from pathlib import Path

from hyjax.data import arkit_scenes, seven_scenes
from hyjax.data.capture import Capture, CaptureFormat
from hyjax.util.errors import InputError

CAPTURE_FORMATS = [
    seven_scenes.FORMAT,
    arkit_scenes.FORMAT,
]
"""The formats of captures; the first one that recognises a folder reads it."""


def register_format(entry: CaptureFormat) -> None:
    """Add a format to `CAPTURE_FORMATS`.

    Raises:
        InputError: there is one of this name.
    """
    if any(entry.name == known.name for known in CAPTURE_FORMATS):
        raise InputError(f"capture format {entry.name!r} is registered already; choose another name")
    CAPTURE_FORMATS.append(entry)


def known_formats() -> str:
    """The formats and their signs in one line, for help texts and messages."""
    return "; ".join(f"{entry.name} ({entry.signs})" for entry in CAPTURE_FORMATS)


def open_capture(path: Path | str | None = None, progress: bool = True) -> Capture:
    """Open the capture in a folder, whichever of `CAPTURE_FORMATS` it has; the built-in room by default.

    Args:
        path: the folder; None for the built-in room.
        progress: show a bar on stderr while the built-in room is rendered for the first time.

    Raises:
        InputError: no such folder, no known format, or an error of the format's own reader.
    """
    if path is None:
        from hyjax.data.builtin_room import load_room

        return load_room(progress=progress)
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: {'not a' if path.exists() else 'no such'} folder; give the folder of a capture")
    for entry in CAPTURE_FORMATS:
        if entry.recognise(path):
            return entry.open(path)
    raise InputError(f"{path}: not a known capture layout; known are: {known_formats()}")
