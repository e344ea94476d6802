"""Captures written in another layout: `hyjax convert`."""

import dataclasses
import logging
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hyjax.data.capture import Capture, ChosenFrames, Frame
from hyjax.data.convert_settings import ConvertSettings, Layout
from hyjax.geometry.camera import Camera
from hyjax.util.errors import InputError
from hyjax.util.files import digest
from hyjax.util.sizes import parse_size

if TYPE_CHECKING:
    import trimesh

_log = logging.getLogger(__name__)


class SelectedFrames(ChosenFrames):
    """Some frames of a capture, with pictures of a size; depth keeps its own, and the mesh stays.

    Args:
        capture: any.
        indices: of its frames.
        size: height and width of the pictures; theirs if None.
    """

    def __init__(self, capture: Capture, indices: list[int], size: tuple[int, int] | None) -> None:
        super().__init__(capture, indices)
        self._size = size

    @property
    def fingerprint(self) -> str:
        """See `Capture`."""
        return digest([super().fingerprint, str(self._size)])

    def __getitem__(self, index: int) -> Frame:
        from hyjax.data.frames import fit

        frame = super().__getitem__(index)
        if self._size is None:
            return frame
        lens = None if frame.depth is None else frame.depth_camera.intrinsics
        fitted = fit(frame, self._size)
        return dataclasses.replace(fitted, depth=frame.depth, depth_intrinsics=lens, confidence=frame.confidence)

    def camera(self, index: int) -> Camera:
        """See `Capture`."""
        return super().camera(index) if self._size is None else self[index].camera

    def mesh(self) -> "trimesh.Trimesh | None":
        """See `Capture`."""
        return self._capture.mesh()

    @property
    def has_mesh(self) -> bool:
        """See `Capture`."""
        return self._capture.has_mesh


def convert(settings: ConvertSettings) -> int:
    """Write a capture in another layout; the number of its frames.

    Args:
        settings: what and where to.

    Raises:
        InputError: the capture cannot be used, the output folder is in use, or a package is missing.
    """
    size = parse_size(settings.size)
    out = Path(settings.out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is there already and not an empty folder; choose another --out")
    writer = _writer(settings.to)
    from hyjax.data.frames import select_frames
    from hyjax.data.registry import open_capture

    capture = open_capture(settings.capture, not settings.quiet, scale=settings.scale, strict=settings.strict)
    if capture.depth_count > len(capture):
        _log.warning(
            "%s: depth maps without a picture have no place in a %s layout; left out", capture.name, settings.to
        )
    chosen = SelectedFrames(capture, select_frames(settings.frames, len(capture)), size)
    return writer(chosen, out, not settings.quiet)


def relight_command(settings: ConvertSettings) -> str:
    """Command that relights the written capture: from its depth, or else with the device's mesh."""
    words = ["hyjax", "relight", "--capture", str(settings.out)]
    has_depth = (settings.out / "depth").is_dir() or any(settings.out.glob("*.depth.png"))
    if not has_depth and (settings.out / "mesh.ply").is_file():
        words += ["--mesh", str(settings.out / "mesh.ply")]
    return shlex.join(words)


def _writer(layout: Layout) -> Callable[[Capture, Path, bool], int]:
    if layout == "arkit":
        from hyjax.data.write_arkit import write_arkit

        return write_arkit
    if layout == "stray":
        from hyjax.data.write_stray import write_stray

        return write_stray
    from hyjax.data.writers import write_7scenes, write_nerfstudio

    return write_7scenes if layout == "7scenes" else write_nerfstudio
