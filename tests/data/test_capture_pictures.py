"""Frames without their depth: `Capture.picture`."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_capture as small
import trimesh
from extras import need
from test_convert import ALL_LAYOUTS, Source

from hyjax.data.builtin_room import RoomCapture
from hyjax.data.capture import Capture, ChosenFrames, Frame
from hyjax.data.convert import SelectedFrames, write_capture
from hyjax.data.frames import small_frame
from hyjax.data.kinect import KINECT, RegisteredKinect
from hyjax.data.registry import open_capture
from hyjax.data.scaled import ScaledCapture
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.scene.alignment import AlignedCapture

MOVED = np.eye(4)
MOVED[0, 3] = 0.25


BOX = trimesh.creation.box((8.0, 8.0, 8.0))


def camera(index: int) -> Camera:
    return Camera(Intrinsics(32, 24, 20.0, 20.0, 16.0, 12.0), small.pose(index))


class KinectSource(Source):
    """The small capture as a Kinect would have it."""

    def __getitem__(self, index: int) -> Frame:
        frame, times = super().__getitem__(index), 640 // small.LENS.width
        image = np.kron(frame.image, np.ones((times, times, 1), np.float32))
        camera = Camera(KINECT, frame.camera.pose)
        depth = np.full(KINECT.shape, 2.0, np.float32)
        return dataclasses.replace(
            frame, image=image, camera=camera, depth=depth, depth_intrinsics=None, confidence=None
        )


def same(frame: Frame, whole: Frame) -> None:
    """A frame is another one without depth."""
    assert frame.depth is None and frame.depth_intrinsics is None and frame.confidence is None
    np.testing.assert_array_equal(frame.image, whole.image)
    np.testing.assert_array_equal(frame.camera.pose, whole.camera.pose)
    told = (frame.name, frame.time, frame.exposure, frame.camera.intrinsics)
    assert told == (whole.name, whole.time, whole.exposure, whole.camera.intrinsics)


@pytest.mark.parametrize(
    "derived",
    [
        lambda _: RoomCapture(np.zeros((2, 24, 32, 3), np.uint8), [camera(0), camera(1)], BOX, {}),
        lambda source: ChosenFrames(source, [1]),
        lambda source: SelectedFrames(source, [1], (24, 24)),
        lambda source: SelectedFrames(source, [1], None),
        lambda source: ScaledCapture(source, 0.5),
        lambda _: RegisteredKinect(KinectSource()),
        lambda source: AlignedCapture(source, np.array([0.0, 1.0]), np.stack([np.eye(4), MOVED])),
    ],
)
def test_a_picture_is_its_frame_without_depth(derived: Callable[[Capture], Capture]) -> None:
    capture = derived(Source())
    for index in range(len(capture)):
        same(capture.picture(index), capture[index])
    assert (capture[0].depth > 0).any()


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_no_depth_map_is_read_for_it(layout: str, tmp_path: Path) -> None:
    if layout == "stray":
        need("captures")
    write_capture(Source(), layout, tmp_path / "out", False)
    capture = open_capture(tmp_path / "out")
    whole = [capture[index] for index in range(len(capture))]
    assert all(frame.depth is not None for frame in whole)
    for file in (tmp_path / "out").rglob("*"):
        if file.is_file() and "depth" in str(file.relative_to(tmp_path)).lower():
            file.write_bytes(b"damaged")
    for index, frame in enumerate(whole):
        same(capture.picture(index), frame)
        same(small_frame(capture, index), frame)
