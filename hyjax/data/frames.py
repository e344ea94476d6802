"""Choosing frames of a capture and bringing them to a size."""

import dataclasses
import re
from collections.abc import Sequence
from typing import TypeVar

import jax.numpy as jnp
import numpy as np

from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.light.color import to_display, to_linear
from hyjax.util.errors import InputError
from hyjax.util.images import resize

SMALL_WIDTH = 640
"""Largest longer side of a small frame, in pixels."""
T = TypeVar("T")


def fit(frame: Frame, size: tuple[int, int] | None) -> Frame:
    """The frame's largest centred window with the proportions of `size` (height, width), resampled to that size.

    Resampling averages light, hence happens in linear values. Depth is dropped: nothing here needs it.

    Raises:
        InputError: a side of less than one pixel.
    """
    depthless = dataclasses.replace(frame, depth=None, depth_intrinsics=None, confidence=None)
    if size is None or size == frame.camera.intrinsics.shape:
        return depthless
    height, width = size
    if min(size) < 1:
        raise InputError(f"size: must be at least 1x1 pixels, got {width}x{height}")
    top, left, window_h, window_w = _window(frame.camera.intrinsics, size)
    linear = np.asarray(to_linear(jnp.asarray(frame.image[top : top + window_h, left : left + window_w])))
    image = np.asarray(to_display(jnp.asarray(resize(linear, height, width))))
    return dataclasses.replace(depthless, image=image, camera=fit_camera(frame.camera, size))


def fit_camera(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """Camera of a frame that `fit` brings to a size."""
    if size is None or size == camera.intrinsics.shape:
        return camera
    intrinsics: Intrinsics = camera.intrinsics.crop(*_window(camera.intrinsics, size)).resize(*size)
    return Camera(intrinsics, camera.pose)


def _window(intrinsics: Intrinsics, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Top, left, height and width of a picture's largest centred window with the proportions of a size."""
    (height, width), (h, w) = size, intrinsics.shape
    scale = min(h / height, w / width)
    window_h, window_w = min(h, round(height * scale)), min(w, round(width * scale))
    if min(window_h, window_w) < 1:
        raise InputError(f"size: {width}x{height} is no part of a {w}x{h} picture; its proportions are too far off")
    return (h - window_h) // 2, (w - window_w) // 2, window_h, window_w


def shrink(frame: Frame, longest: int) -> Frame:
    """The frame with a longer side of at most `longest` pixels; see `fit`."""
    height, width = frame.camera.intrinsics.shape
    share = min(1.0, longest / max(height, width))
    return fit(frame, (max(1, round(height * share)), max(1, round(width * share))))


def small_frame(capture: Capture, index: int, *, keep: bool = False) -> Frame:
    """Frame of a capture without its depth, its longer side at most `SMALL_WIDTH` pixels.

    Args:
        keep: whether its picture stays in memory until it is asked for once more.
    """
    source = capture.picture_source
    kept: dict[int, Frame] = source.__dict__.setdefault("_small_frames", {})
    frame = kept.pop(index, None) or shrink(source.picture(index), SMALL_WIDTH)
    if keep:
        kept[index] = frame
    if source is capture:
        return frame
    return dataclasses.replace(frame, camera=fit_camera(capture.camera(index), frame.camera.intrinsics.shape))


def forget_small_frames(capture: Capture) -> None:
    """Forget the pictures that `small_frame` has kept."""
    capture.picture_source.__dict__.pop("_small_frames", None)


def select_frames(text: str, count: int) -> list[int]:
    """Frame indices from `all`, `7`, `0:300:30` (as Python slices) or a comma-separated list of these."""
    chosen: list[int] = []
    for numbers in frame_numbers(text):
        first = numbers[0] or 0
        last = numbers[1] if len(numbers) > 1 else first + 1 if first != -1 else None
        if not -count <= first < count or not -count <= (last or 0) <= count:
            raise InputError(f"frames: {text!r} runs past the end; the capture has frames 0 to {count - 1}")
        chosen += range(count)[slice(numbers[0], last, numbers[2] if len(numbers) > 2 else None)]
    chosen = list(dict.fromkeys(chosen))
    if not chosen:
        raise InputError(f"frames: {text!r} selects no frame of 0 to {count - 1}")
    return chosen


def frame_numbers(text: str) -> list[list[int | None]]:
    """Numbers of each part of what `select_frames` takes, before the capture is known."""
    found = []
    for part in text.split(","):
        fields = ["", "", ""] if part.strip() == "all" else part.strip().split(":")
        try:
            numbers = [int(field) if field.strip() else None for field in fields]
        except ValueError:
            numbers = []
        if not 1 <= len(numbers) <= 3 or numbers == [None] or numbers[2:] == [0]:
            forms = "all, 7, 0:300:30 (start:end:step, without the end) or a list of these"
            ends = re.fullmatch("([0-9]{1,9})-([0-9]{1,9})", part.strip())
            if ends and int(ends[1]) <= int(ends[2]):
                forms += f"; {ends[0]} is written {ends[1]}:{int(ends[2]) + 1}"
            raise InputError(f"frames: {text!r} is not of the form {forms}")
        found.append(numbers)
    return found


def spread(items: Sequence[T], count: int) -> list[T]:
    """At most `count` of the items, evenly spread, first and last among them; none if there are none."""
    if count < 1:
        raise InputError(f"frames: must be at least 1, got {count}")
    if not items:
        return []
    return [items[i] for i in sorted({int(i) for i in np.linspace(0, len(items) - 1, count).round()})]
