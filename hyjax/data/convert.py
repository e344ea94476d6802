"""Captures written in another layout: `hyjax convert`."""

import dataclasses
import logging
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

from hyjax.data.capture import Capture, ChosenFrames, Frame
from hyjax.data.convert_settings import ConvertSettings, Layout
from hyjax.geometry.camera import Camera
from hyjax.util.errors import InputError
from hyjax.util.files import digest, new_folder
from hyjax.util.sizes import parse_size

if TYPE_CHECKING:
    import trimesh

TIMED_LAYOUTS = ("arkit", "stray")
"""Layouts with a time of each frame."""
_log = logging.getLogger(__name__)


class SelectedFrames(ChosenFrames):
    """Some frames of a capture, with pictures of a size; depth keeps its own, and the mesh stays.

    Args:
        size: height and width of the pictures; theirs if None.
    """

    def __init__(self, capture: Capture, indices: list[int], size: tuple[int, int] | None) -> None:
        super().__init__(capture, indices)
        self._size = size

    @property
    def fingerprint(self) -> str:
        return digest([super().fingerprint, str(self._size)])

    def __getitem__(self, index: int) -> Frame:
        from hyjax.data.frames import fit

        frame = super().__getitem__(index)
        if self._size is None:
            return frame
        lens = None if frame.depth is None else frame.depth_camera.intrinsics
        fitted = fit(frame, self._size)
        return dataclasses.replace(fitted, depth=frame.depth, depth_intrinsics=lens, confidence=frame.confidence)

    def picture(self, index: int) -> Frame:
        from hyjax.data.frames import fit

        return fit(super().picture(index), self._size)

    def camera(self, index: int) -> Camera:
        return super().camera(index) if self._size is None else self.picture(index).camera

    def mesh(self) -> "trimesh.Trimesh | None":
        return self._capture.mesh()

    @property
    def has_mesh(self) -> bool:
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
    from hyjax.data.frames import select_frames
    from hyjax.data.registry import open_capture

    quiet, scale, strict = settings.quiet, settings.scale, settings.strict
    capture = open_capture(settings.capture, not quiet, size=size, scale=scale, strict=strict)
    if capture.depth_count > len(capture):
        _log.warning(
            "%s: depth maps without a picture have no place in a %s layout; left out", capture.name, settings.to
        )
    chosen = SelectedFrames(capture, select_frames(settings.frames, len(capture)), size)
    return write_capture(chosen, settings.to, out, not settings.quiet)


def relight_command(settings: ConvertSettings) -> str:
    """Command that relights the written capture: from its depth, or else with the device's mesh."""
    words = ["hyjax", "relight", "--capture", str(settings.out)]
    has_depth = (settings.out / "depth").is_dir() or any(settings.out.glob("*.depth.png"))
    if not has_depth and (settings.out / "mesh.ply").is_file():
        words += ["--mesh", str(settings.out / "mesh.ply")]
    return shlex.join(words)


def write_capture(capture: Capture, layout: Layout, out: Path, progress: bool = True) -> int:
    """Write a capture in a layout, whose `fill_` function names the parts that are kept.

    Args:
        capture: any; frames that are damaged are left out with a line, unless it is strict.
        out: folder, which must not be there or be empty; it appears whole or not at all.

    Returns:
        The number of frames, without those that are damaged.
    """
    from hyjax.data import write_arkit, write_stray, writers

    fill, folders = {
        "7scenes": (writers.fill_7scenes, ()),
        "nerfstudio": (writers.fill_nerfstudio, ("images", "depth")),
        "arkit": (write_arkit.fill_arkit, write_arkit.FOLDERS),
        "stray": (write_stray.fill_stray, write_stray.FOLDERS),
    }[layout]
    if layout in TIMED_LAYOUTS and not capture.times_known:
        _log.warning(
            "%s: no times were recorded; made-up ones are written, in the order of the frames", capture.name
        )
    count = 0

    def frames() -> Iterator[tuple[int, Frame]]:
        nonlocal count
        for index in tqdm(range(len(capture)), "writing", unit="frame", leave=False, disable=not progress):
            try:
                frame = capture[index]
            except InputError as error:
                if capture.strict:
                    raise
                _log.warning("%s; this frame is left out", error)
                continue
            count += 1
            yield count - 1, frame
        if not count:
            raise InputError(f"{capture.name}: none of the chosen frames can be read")

    with new_folder(out) as folder:
        for name in folders:
            (folder / name).mkdir()
        fill(capture, frames(), folder)
        for name in folders:
            if not any((folder / name).iterdir()):
                (folder / name).rmdir()
    return count
