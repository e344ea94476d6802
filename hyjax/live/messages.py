"""Messages of live frames, as `hyjax tour --live -` reads them from stdin; `docs/live_frames.md` describes them.

A message is a line of JSON, then the bytes of its parts, whose lengths the line tells. What does not begin a
message is skipped up to the next line that does, with a line on stderr.
"""

import json
import logging
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from hyjax.data.capture import Frame
from hyjax.data.capture_files import bytes_colour
from hyjax.data.recording import rigid
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.util.arguments import checked_arguments
from hyjax.util.errors import InputError
from hyjax.util.images import picture_file
from hyjax.util.reading import parse_json

KIND = "hyjax-live-1"
LONGEST_LINE = 16_384
LARGEST_PART = 1 << 26
"""Largest part of a message, bytes; a header with more is taken for a damaged one."""
LARGEST_SIDE = 8192
QUALITY = 90
_log = logging.getLogger(__name__)


@checked_arguments
def write_live_frame(stream: BinaryIO, frame: Frame) -> None:
    """Write a frame as a message: its picture as JPEG, its depth in whole millimetres."""
    picture = picture_file(frame.image, quality=QUALITY)
    header: dict[str, Any] = {
        "kind": KIND,
        "name": frame.name,
        "time": float(frame.time),
        "pose": np.asarray(frame.camera.pose, float).tolist(),
        "intrinsics": _numbers(frame.camera.intrinsics),
        "picture_bytes": len(picture),
    }
    depth = b""
    if frame.depth is not None:
        readings = np.nan_to_num(np.asarray(frame.depth, float), nan=0.0, posinf=0.0, neginf=0.0)
        depth = np.clip(np.round(1000.0 * readings), 0, 65534).astype("<u2").tobytes()
        header["depth_intrinsics"] = _numbers(frame.depth_camera.intrinsics)
        header["depth_bytes"] = len(depth)
    stream.write(json.dumps(header).encode() + b"\n" + picture + depth)
    stream.flush()


def read_live_frames(stream: BinaryIO) -> Iterator[Frame]:
    """Frames from messages, until the stream ends; damaged ones are skipped with a line."""
    skipping = False
    while line := stream.readline(LONGEST_LINE):
        header = _header(line)
        if header is None:
            if not skipping:
                _log.warning("live: what is no message is skipped up to the next one")
            skipping = True
            continue
        skipping = False
        sizes = [header.get(key, 0) for key in ("picture_bytes", "depth_bytes")]
        picture, depth = (_exactly(stream, size) for size in sizes)
        if [len(picture), len(depth)] != sizes:
            _log.warning("live: the stream ends within a message")
            return
        try:
            frame = _frame(header, picture, depth)
        except Exception as error:  # one message, however damaged, does not end the stream
            _log.warning("live: message skipped: %s", error)
            continue
        yield frame


def _header(line: bytes) -> dict[str, Any] | None:
    """Header of a message; None if the line is not one. A damaged part before it may end in its line."""
    start = line.find(b'{"kind": "' + KIND.encode())
    try:
        header = parse_json(line[start:], "live") if start >= 0 else None
    except InputError:
        return None
    if not isinstance(header, dict):
        return None
    sizes = [header.get(key, 0) for key in ("picture_bytes", "depth_bytes")]
    return header if all(type(size) is int and 0 <= size <= LARGEST_PART for size in sizes) else None


def _exactly(stream: BinaryIO, count: int) -> bytes:
    """So many bytes, or fewer where the stream ends: a read of a pipe may bring a part of them."""
    content = b""
    while len(content) < count and (part := stream.read(count - len(content))):
        content += part
    return content


def _frame(header: dict[str, Any], picture: bytes, depth: bytes) -> Frame:
    name = str(header.get("name", ""))[:80] or "unnamed"
    try:
        pose = rigid(np.array(header["pose"], np.float64))
        seconds = float(header["time"])
        lens = _intrinsics(header["intrinsics"])
        depth_lens = _intrinsics(header["depth_intrinsics"]) if depth else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: its first line lacks something ({type(error).__name__}: {error})") from None
    if pose is None or not np.isfinite(seconds):
        raise InputError(f"{name}: its pose or time is not valid")
    suffix = ".png" if picture.startswith(b"\x89PNG") else ".jpg"
    image = bytes_colour(picture, suffix, f"picture of {name}")
    readings = None
    if depth_lens is not None:
        if len(depth) != 2 * depth_lens.width * depth_lens.height:
            raise InputError(f"{name}: {len(depth)} bytes of depth are not {depth_lens.width}x{depth_lens.height}")
        stored = np.frombuffer(depth, "<u2").reshape(depth_lens.shape)
        readings = np.where(stored == 65535, 0, stored).astype(np.float32) * np.float32(0.001)
    return Frame(name, image, Camera(lens, pose), seconds, readings, depth_lens)


def _intrinsics(values: dict[str, Any]) -> Intrinsics:
    width, height = int(values["width"]), int(values["height"])
    if max(width, height) > LARGEST_SIDE:
        raise InputError(f"intrinsics: {width}x{height} is larger than {LARGEST_SIDE} a side")
    return Intrinsics(width, height, *(float(values[key]) for key in ("fx", "fy", "cx", "cy")))


def _numbers(k: Intrinsics) -> dict[str, float]:
    return {"width": k.width, "height": k.height, "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy}
