"""Parts that readers of phones' scans share: poses, lenses, depth with confidence, counts of faults."""

import itertools
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from hyjax.data.capture_files import Tally, intrinsics_at, looks_whole, tree_depth, tree_labels, tree_shape
from hyjax.data.file_tree import FileTree
from hyjax.data.recording import Y_UP, DepthAndConfidence, Recording, Shot, from_opengl, usable_pose
from hyjax.geometry.camera import Intrinsics
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.util.errors import InputError

ARKIT_LEVELS = (0, 1, 2)
"""ARKit's confidence levels: low, medium, high."""
PIXEL_CENTRE = 0.5
"""Offset of our principal point from ARKit's, whose pixel centres are at whole numbers: ARKit's own projection
matrices, which 3D Scanner App keeps beside the intrinsics, agree with these to 0.001 pixels if it is added."""


def arkit_pose(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"] | None:
    """`usable_pose` of a camera in ARKit's axes, in ours."""
    result = usable_pose(pose)
    return None if result is None else from_opengl(result)


def lens_of(
    shape: tuple[int, int], focal_and_centre: Sequence[float], where: str, *, shift: float = 0.0
) -> Intrinsics:
    """Intrinsics of pictures of (height, width) from fx, fy, cx, cy; `shift` is added to cx and cy."""
    fx, fy, cx, cy = (float(value) for value in focal_and_centre)
    height, width = shape
    lens = intrinsics_at(where, width, height, fx, fy, cx + shift, cy + shift)
    if not (0 < cx < width and 0 < cy < height and 0.05 * width < fx < 100 * width):
        raise InputError(
            f"{where}: focal length {fx:g} and centre ({cx:g}, {cy:g}) do not belong to {width}x{height} pictures"
        )
    return lens


def confidence_from_levels(
    found: np.ndarray, levels: tuple[int, int, int] = ARKIT_LEVELS
) -> Float[np.ndarray, "h w"]:
    """Confidence in [0, 1] from a device's low, medium and high; greater levels count as high."""
    return np.interp(found, levels, (0.0, 0.5, 1.0)).astype(np.float32)


def shape_of_pictures(tree: FileTree, names: Sequence[str]) -> tuple[int, int]:
    """(height, width) of a capture's pictures, by the header of the first."""
    if not names:
        raise InputError(f"{tree.path}: has no pictures that can be read")
    return tree_shape(tree, names[0])


class PhoneScan:
    """Shots of a phone's scan before they become a recording, with counts of faults and remarks."""

    def __init__(self, tree: FileTree) -> None:
        self.tree, self.faults, self.remarks = tree, Tally(), Tally()

    def whole(self, name: str, what: str) -> str | None:
        """Name of a file that is there and whole, else None; a damaged one is counted in `faults` as `what`."""
        if name not in self.tree:
            return None
        if looks_whole(self.tree, name):
            return name
        self.faults.add(f"{what} are damaged and left out", name)
        return None

    def depth(
        self, depth: str, confidence: str | None, *, levels: tuple[int, int, int] = ARKIT_LEVELS
    ) -> Callable[[], DepthAndConfidence] | None:
        """Reads a depth map in millimetres and its confidence map, whose `levels` become 0, 0.5 and 1.

        None if the depth map is not there, or damaged.
        """
        tree, maps = self.tree, self.whole(depth, "depth maps")
        confidences = confidence and self.whole(confidence, "confidence maps")
        if maps is None:
            return None

        def read() -> DepthAndConfidence:
            metres = tree_depth(tree, maps)
            if not confidences:
                return metres, None
            found = tree_labels(tree, confidences)
            if found.shape != metres.shape:
                raise InputError(
                    f"{tree.where(confidences)}: is {found.shape[1]}x{found.shape[0]} but its depth map is "
                    f"{metres.shape[1]}x{metres.shape[0]}; the two must have one size"
                )
            return metres, confidence_from_levels(found, levels)

        return read

    def usable(self, reads: Iterable[Callable[[], Shot | None]]) -> list[Shot]:
        """Shots of the frames that can be used; the others are counted in `faults`.

        Args:
            reads: each reads one frame; None for one that has been counted already.
        """
        shots: list[Shot] = []
        first: InputError | None = None
        for read in reads:
            try:
                shot = read()
            except InputError as error:
                first = first or error
                self.faults.add("frames cannot be used and are left out", str(error))
                continue
            if shot is not None:
                shots.append(shot)
        if first is not None and not shots:
            raise first
        return shots

    def shot(
        self,
        source: str,
        name: str,
        time: float,
        pose: Float[np.ndarray, "4 4"] | None,
        intrinsics: Intrinsics,
        picture: Callable[[], Float[np.ndarray, "h w 3"]] | None,
        depth: Callable[[], DepthAndConfidence] | None,
        *,
        depth_intrinsics: Intrinsics | None = None,
        exposure: float | None = None,
    ) -> Shot | None:
        """A shot, with a remark if it lacks picture or depth; None, counted in `faults`, without a valid pose."""
        if pose is None:
            self.faults.add("poses are unusable (not finite, or no rotation) and left out", source)
            return None
        if picture is None:
            self.remarks.add(
                "poses have no picture" + ("; their depth is used" if depth else " and no depth"), source
            )
        elif depth is None:
            self.remarks.add("pictures have no depth", source)
        return Shot(name, time, pose, intrinsics, picture, depth, depth_intrinsics, exposure=exposure)

    def recording(
        self,
        shots: Sequence[Shot],
        *,
        up: Float[np.ndarray, "3"] | None = Y_UP,
        mesh: str | None = None,
        name: str | None = None,
    ) -> Recording:
        """The recording of some shots in order of time, with a remark if their clock goes back.

        Args:
            shots: in the order in which the files have them.
            mesh: name of the device's mesh, where there is one.
        """
        for before, after in itertools.pairwise(shots):
            if after.time < before.time:
                self.remarks.add("times go back, frames are taken in order of time", after.name)
        return Recording(
            self.tree,
            sorted(shots, key=lambda shot: shot.time),
            name=name,
            up=up,
            mesh=mesh if mesh is not None and mesh in self.tree else None,
            sensor=PHONE_LIDAR,
            faults=self.faults.lines(),
            remarks=self.remarks.lines(),
        )
