"""Sources of live frames: a folder that grows, a stream of messages, and a phone with Record3D."""

import logging
import queue
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from hyjax.data.capture import Frame
from hyjax.data.capture_files import looks_whole, tree_colour, tree_depth, tree_numbers
from hyjax.data.file_tree import FileTree
from hyjax.data.frames import spread
from hyjax.data.recording import Y_UP, from_opengl, pose_from_quaternion, rigid
from hyjax.data.seven_scenes import FRAME, FRAMES_PER_SECOND, read_intrinsics, read_up
from hyjax.data.trees import open_tree
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.live.messages import read_live_frames
from hyjax.util.errors import InputError

POLL = 0.1
"""Seconds between two looks at a folder."""
MOST_NEW_FRAMES = 10
"""Frames that are taken from one look; of more, so many are taken that are spread over them."""
MOST_FIRST_FRAMES = 150
"""The same for frames that are there at the start."""
RECORD3D_WAIT = 10.0
"""Seconds without a frame from a phone after which it is taken to have gone."""
_log = logging.getLogger(__name__)


def live_frames(source: str) -> Iterator[Frame]:
    """Frames from `-` (messages on stdin), `record3d` (a phone on USB) or a folder that grows."""
    if source == "-":
        return read_live_frames(sys.stdin.buffer)
    if source == "record3d":
        return record3d_frames()
    if not Path(source).is_dir():
        raise InputError(f"live: {source}: no such folder; give a folder, '-' for stdin, or 'record3d'")
    return folder_frames(Path(source))


def known_up(source: str) -> Float[np.ndarray, "3"] | None:
    """Unit vector against gravity that a source knows: a phone's y, a folder's file; None if it knows none."""
    if source == "record3d":
        return Y_UP
    return None if source == "-" or not Path(source).is_dir() else read_up(open_tree(Path(source)))


def folder_frames(folder: Path, *, stop_after: float | None = None) -> Iterator[Frame]:
    """Frames of a folder in the 7-Scenes layout, in the order of their numbers, as soon as they are whole.

    A frame is taken when its picture, depth map and pose are all there to their ends; one that comes after a later
    one was taken is left out with a line. `camera-intrinsics.txt` must be there before the first frame, or the
    pictures have the size of the 7-Scenes Kinect.

    Args:
        stop_after: end when it has not grown for so many seconds; None to look for ever.
    """
    last, done, most = -1, set[int](), MOST_FIRST_FRAMES
    grown = time.monotonic()
    while stop_after is None or time.monotonic() - grown <= stop_after:
        tree = open_tree(folder)
        numbers = {int(match[1]): name for name in tree.below("") if (match := FRAME.fullmatch(name))}
        late = [n for n in numbers if n < last and n not in done and _is_whole(tree, numbers[n])]
        if late:
            _log.warning("live: %d frames came after later ones and are left out (%s)", len(late), numbers[late[0]])
        done.update(late)
        new = [n for n in sorted(numbers) if n > last and _is_whole(tree, numbers[n])]
        for number in spread(new, most) if new else []:
            last = number
            try:
                yield _folder_frame(tree, number, numbers[number])
            except InputError as error:
                _log.warning("live: frame left out: %s", error)
        done.update(new)
        if new:
            grown, most = time.monotonic(), MOST_NEW_FRAMES
        else:
            time.sleep(POLL)


def _is_whole(tree: FileTree, colour: str) -> bool:
    stem = colour.split(".")[0]
    pose, depth = f"{stem}.pose.txt", f"{stem}.depth.png"
    if pose not in tree or depth not in tree:
        return False
    try:
        return looks_whole(tree, colour) and looks_whole(tree, depth) and len(tree.text(pose).split()) == 16
    except InputError:
        return False


def _folder_frame(tree: FileTree, number: int, colour: str) -> Frame:
    stem, where = colour.split(".")[0], tree.where(colour)
    pose = rigid(tree_numbers(tree, f"{stem}.pose.txt", (4, 4)))
    if pose is None:
        raise InputError(f"{where}: its pose is not valid (not finite, or no rigid motion)")
    image, depth = tree_colour(tree, colour), tree_depth(tree, f"{stem}.depth.png")
    lens = read_intrinsics(tree, image.shape[:2], [])
    depth_lens = None if depth.shape == image.shape[:2] else lens.resize(*depth.shape)
    time_of = number / FRAMES_PER_SECOND
    return Frame(f"frame-{number:06d}", image, Camera(lens, pose), time_of, depth, depth_lens)


def record3d_frames() -> Iterator[Frame]:
    """Frames of a phone that streams with the app Record3D over USB. **Nobody has tried this with a phone.**

    After the package's interface (https://github.com/marek-simonik/record3d). The axes are taken to be ARKit's.
    """
    try:
        from record3d import Record3DStream
    except ImportError:
        raise InputError("live: record3d: needs the package record3d: pip install record3d") from None
    devices = Record3DStream.get_connected_devices()
    if not devices:
        raise InputError("live: record3d: no phone; connect one by USB and start the app's USB streaming")
    stream, ready = Record3DStream(), queue.Queue[bool](maxsize=1)

    def arrived() -> None:
        if ready.empty():
            ready.put(True)

    stream.on_new_frame = arrived
    stream.on_stream_stopped = lambda: ready.put(False)
    if not stream.connect(devices[0]):
        raise InputError("live: record3d: the phone does not stream; press its red button")
    begun, number = time.monotonic(), 0
    while True:
        try:
            if not ready.get(timeout=RECORD3D_WAIT):
                return
        except queue.Empty:
            raise InputError(f"live: record3d: no frame for {RECORD3D_WAIT:g} s") from None
        try:
            yield _record3d_frame(stream, number, time.monotonic() - begun)
        except InputError as error:
            _log.warning("live: frame left out: %s", error)
        number += 1


def _record3d_frame(stream: Any, number: int, seconds: float) -> Frame:
    colour: UInt8[np.ndarray, "h w 3"] = stream.get_rgb_frame()
    depth: Float[np.ndarray, "dh dw"] = stream.get_depth_frame()
    k, p = stream.get_intrinsic_mat(), stream.get_camera_pose()
    height, width = colour.shape[:2]
    pose = pose_from_quaternion(np.array([p.qx, p.qy, p.qz, p.qw]), np.array([p.tx, p.ty, p.tz]))
    if pose is None:
        raise InputError(f"record3d: frame {number}: its pose is not valid")
    lens = Intrinsics(width, height, float(k.fx), float(k.fy), float(k.tx), float(k.ty))
    image = colour.astype(np.float32) / 255.0
    usable = np.nan_to_num(np.asarray(depth, np.float32), nan=0.0)
    return Frame(
        f"{number:06d}", image, Camera(lens, from_opengl(pose)), seconds, usable, lens.resize(*usable.shape)
    )
