"""Depth of the first Kinect, registered to its pictures.

7-Scenes comes as the sensor gave it: intrinsics and poses are those of the *depth* camera, and the pictures are
from another one beside it, of another focal length. Taken for registered, borders are off by a tenth of their
distance from the centre, and near ones by the baseline between the cameras as well.

The baseline is that of a published calibration of another Kinect
(projet.liris.cnrs.fr/voir/activities-dataset/kinect-calibration.html). Focal length, centre and roll were fitted
by us to frames 0-448 of the red kitchen, borders of depth on borders of the pictures.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture, DerivedCapture, Frame
from hyjax.geometry.camera import Camera, Intrinsics
from hyjax.geometry.depth_sensor import KINECT as KINECT_SENSOR
from hyjax.util.files import digest

KINECT = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
"""Intrinsics of the depth camera, as the page of 7-Scenes gives them."""
COLOUR = Intrinsics(640, 480, 526.2, 526.2, 320.2, 237.5)
BASELINE = 0.0256  # metres from the depth camera to the colour camera, along +x
ROLL = 0.0094  # radians about the axis, of points on their way from the depth camera's axes to the colour camera's


def registered(capture: Capture) -> Capture:
    """The capture with depth as its pictures' camera sees it, if it is a Kinect's and that has not been done.

    Such a one is known by its intrinsics, those of the depth camera in 7-Scenes' release.
    """
    return RegisteredKinect(capture) if capture.camera(0).intrinsics == KINECT else capture


class RegisteredKinect(DerivedCapture):
    """A capture whose frames have the colour camera's pose and intrinsics; its depth maps are as they were."""

    def __init__(self, capture: Capture) -> None:
        super().__init__(capture)
        self.sensor = KINECT_SENSOR

    @property
    def fingerprint(self) -> str:
        return digest([self.source.fingerprint, f"{COLOUR} {BASELINE} {ROLL}"])

    def __getitem__(self, index: int) -> Frame:
        frame = self.source[index]
        camera = self.camera(index)
        depth = None if frame.depth is None else warped(frame.depth, frame.depth_camera, camera)
        return dataclasses.replace(frame, camera=camera, depth=depth, depth_intrinsics=None, confidence=None)

    def camera(self, index: int) -> Camera:
        return Camera(COLOUR, self.source.camera(index).pose @ colour_pose())


def colour_pose() -> Float[np.ndarray, "4 4"]:
    """Pose of the colour camera in the depth camera's axes."""
    cos, sin = np.cos(ROLL), np.sin(ROLL)
    to_colour = np.eye(4)
    to_colour[:2, :2] = [[cos, -sin], [sin, cos]]
    to_colour[0, 3] = -BASELINE
    return np.linalg.inv(to_colour)


def warped(depth: Float[np.ndarray, "h w"], camera: Camera, target: Camera) -> Float[np.ndarray, "th tw"]:
    """A depth map as another camera would have it: the nearest reading in each pixel, 0 where there is none.

    Every reading goes to one pixel, so `target` must not have finer pixels than `camera`.
    """
    pixel, distance = target.project(camera.unproject(depth)[depth > 0])
    height, width = target.intrinsics.shape
    inside = np.all((pixel >= 0) & (pixel < (width, height)), axis=-1) & (distance > 0)
    column, row = np.floor(pixel[inside]).astype(int).T
    nearest = np.full((height, width), np.inf)
    np.minimum.at(nearest, (row, column), distance[inside])
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)
