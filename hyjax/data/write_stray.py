"""Any capture written as a Stray Scanner recording; see `hyjax.data.stray` for the layout."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, Frame
from hyjax.data.phone_captures import PIXEL_CENTRE
from hyjax.data.recording import Y_UP
from hyjax.data.stray import LENS, MATRIX, NEEDED_COLUMNS, ODOMETRY, VIDEO
from hyjax.data.video_frames import new_video
from hyjax.data.writers import Frames, seen_through, turned_up
from hyjax.util.errors import InputError
from hyjax.util.files import write_text
from hyjax.util.images import to_bytes, write_depth, write_labels

QUALITY = {"crf": "6", "g": "15", "x265-params": "log-level=none"}
"""Options of the encoders; at this constant rate factor most pixels change by less than a step of 8 bits."""
FOLDERS = ("depth", "confidence")


def fill_stray(capture: Capture, frames: Frames, folder: Path) -> None:
    """A Stray Scanner recording, of frames of one size, with depth and confidence where they have any.

    The world is turned so that up is y. Exposures and the device's mesh are not kept, nor depth maps that no frame
    has; depth that is seen through another lens than the picture's is sampled anew, as this layout has one lens.
    """
    turn = turned_up(capture.up, Y_UP)
    rows: list[list[float]] = []

    def pictures() -> Iterator[Float[np.ndarray, "h w 3"]]:
        for number, frame in frames:
            _write_depth(folder, number, frame)
            rows.append(_row(frame, turn))
            yield frame.image

    _write_video(folder / VIDEO, pictures())
    lines = (
        ", ".join([repr(time), f"{number:06d}", *map(repr, numbers)])
        for number, (time, *numbers) in enumerate(rows)
    )
    write_text(folder / ODOMETRY, "\n".join([", ".join((*NEEDED_COLUMNS, *LENS)), *lines]) + "\n")
    fx, fy, cx, cy = rows[-1][-4:]
    write_text(folder / MATRIX, f"{fx!r}, 0.0, {cx!r}\n0.0, {fy!r}, {cy!r}\n0.0, 0.0, 1.0\n")


def _row(frame: Frame, turn: Float[np.ndarray, "4 4"]) -> list[float]:
    """A row of the table without the frame's number."""
    pose, k = turn @ frame.camera.pose, frame.camera.intrinsics
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
    lens = (k.fx, k.fy, k.cx - PIXEL_CENTRE, k.cy - PIXEL_CENTRE)
    return [float(value) for value in (frame.time, *pose[:3, 3], *quaternion, *lens)]


def _write_video(path: Path, pictures: Iterator[Float[np.ndarray, "h w 3"]]) -> None:
    """Thirty pictures a second, colours at full resolution."""
    first = next(pictures)
    # Colours of this format also take sizes that are odd.
    with new_video(path, first.shape[:2], 30, "yuv444p", **QUALITY) as add:
        for number, picture in enumerate(itertools.chain([first], pictures)):
            if picture.shape != first.shape:
                sizes = [f"{shape[1]}x{shape[0]}" for shape in (picture.shape, first.shape)]
                raise InputError(
                    f"{path.name}: frame {number} is {sizes[0]}, the first is {sizes[1]}; a video has one size"
                )
            add(to_bytes(picture))


def _write_depth(folder: Path, number: int, frame: Frame) -> None:
    if frame.depth is None:
        return
    source, lens = frame.depth_camera.intrinsics, frame.camera.intrinsics.resize(*frame.depth.shape)
    write_depth(folder / f"depth/{number:06d}.png", seen_through(frame.depth, source, lens, nearest=True))
    if frame.confidence is not None:
        confidence = seen_through(frame.confidence, source, lens, nearest=True)
        levels = np.round(np.clip(confidence, 0.0, 1.0) * 2.0).astype(np.uint8)
        write_labels(folder / f"confidence/{number:06d}.png", levels)
