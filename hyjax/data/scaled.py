"""Captures whose poses are in a unit of their own, brought to metres."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from hyjax.data.capture import Capture, DerivedCapture, Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import DepthReading
from hyjax.util.files import digest

if TYPE_CHECKING:
    import trimesh


class ScaledCapture(DerivedCapture):
    """A capture with its poses, its mesh and the depth that was computed from them, in metres.

    Args:
        capture: in units of its own. A sensor's depth is metric as it is; see `Capture.depth_in_units`.
        scale: metres in one unit.
    """

    def __init__(self, capture: Capture, scale: float) -> None:
        super().__init__(capture)
        self._scale, self._of_depth = scale, scale if capture.depth_in_units else 1.0
        self.metric, self.depth_in_units, self.laser_folder = True, False, None
        self.anchors = {name: _scaled_anchor(anchor, scale) for name, anchor in capture.anchors.items()}

    @property
    def fingerprint(self) -> str:
        return digest([self.source.fingerprint, repr(self._scale)])

    def __getitem__(self, index: int) -> Frame:
        frame = self.source[index]
        depth = None if frame.depth is None else frame.depth * np.float32(self._of_depth)
        return dataclasses.replace(frame, camera=self._scaled(frame.camera), depth=depth)

    def camera(self, index: int) -> Camera:
        return self._scaled(self.source.camera(index))

    def depth_reading(self, index: int) -> DepthReading:
        depth, camera, confidence = self.source.depth_reading(index)
        return DepthReading(depth * np.float32(self._of_depth), self._scaled(camera), confidence)

    def mesh(self) -> "trimesh.Trimesh | None":
        mesh = self.source.mesh()
        return None if mesh is None else mesh.copy().apply_scale(self._scale)

    def _scaled(self, camera: Camera) -> Camera:
        pose: Float[np.ndarray, "4 4"] = camera.pose.copy()
        pose[:3, 3] *= self._scale
        return Camera(camera.intrinsics, pose)


def _scaled_anchor(anchor: Mapping[str, Any], scale: float) -> dict[str, Any]:
    """Anchor of a light with its lengths and points scaled; its direction stays."""
    return {key: value if key == "normal" else np.multiply(value, scale).tolist() for key, value in anchor.items()}
