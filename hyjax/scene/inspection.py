"""Inspection of a capture: its content, the agreement of its parts, and doubts."""

import dataclasses
import functools
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from tqdm import tqdm

from hyjax.data.capture import Capture, Frame
from hyjax.data.frames import spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import NEAR_LIMIT, READING_TOLERANCE
from hyjax.scene.fusion import LEAST_OVERLAP, LOW_COVERAGE, Readings, coverage_of, plan_fusion
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.surfaces import ENOUGH_COVERAGE
from hyjax.util.cores import cores
from hyjax.util.errors import InputError
from hyjax.util.prefetch import prefetch
from hyjax.util.vectors import orthonormal_frame

SAMPLE_COUNT = 12
"""Number of frames and depth maps to read."""
QUICK_COUNT, QUICK_SIDE = 4, 640
"""Largest number of frames of a first look at a relit capture, and their longer side in pixels."""
MOST_PLAN_POINTS = 20_000
"""Points of the surface in the plan, at most."""
SPAN_QUANTILES = (0.01, 0.99)
"""Quantiles of the surface's coordinates that its range is told by: single wrong readings lie far away."""
SHOWN_COUNT, SHOWN_LENGTH = 4, 480
"""Number of frames in the picture of an inspection, and the least longer side that they are kept at, in pixels."""
USUAL_DEPTH = (0.1, 20.0)
"""Range of the median depth of a room, in metres."""
UPSIDE_DOWN_COSINE = -0.5
"""Mean cosine between the pictures' upward direction and up, below which one of them is wrong."""
LONGEST_STEP = 1.0
"""Largest distance, in metres, between neighbouring frames of a walk."""


@dataclasses.dataclass(frozen=True)
class ShownFrame:
    """Frame in the picture of an inspection.

    Attributes:
        depth: metres, 0 where unknown; None without any.
    """

    title: str
    image: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "dh dw"] | None

    @classmethod
    def of(cls, frame: Frame, *, times_known: bool) -> "ShownFrame":
        """Frame with means of the cells of its picture."""
        height, width = frame.image.shape[:2]
        step = max(1, max(height, width) // SHOWN_LENGTH)
        rows, columns = max(1, height // step), max(1, width // step)
        cells = frame.image[: rows * step, : columns * step].reshape(rows, -1, columns, min(step, width), 3)
        title = f"{frame.name}, {frame.time:.1f} s" if times_known else frame.name
        return cls(title, cells.mean(axis=(1, 3)), frame.depth)


@dataclasses.dataclass(frozen=True)
class Inspection:
    """Content of a capture.

    Attributes:
        sizes: (width, height) of the pictures that were read.
        exposures: seconds of the pictures that were read, where the device records them.
        seconds: from the first frame to the last; 0 where times were not recorded.
        positions: of the cameras, metres.
        depth_size: (width, height) of the depth maps; None without any.
        coverage: agreement of mesh and depth; without a mesh, only the share with depth; None without depth.
        quantiles: of depth in metres: least, median, most, but for a hundredth at both ends.
        mesh: that the device made; None without one.
        doubts: possible faults, a line each.
        shown: a few of the frames that were read.
    """

    capture: Capture
    sizes: list[tuple[int, int]]
    exposures: list[float]
    seconds: float
    positions: Float[np.ndarray, "n 3"]
    depth_size: tuple[int, int] | None
    coverage: Coverage | None
    quantiles: tuple[float, float, float] | None
    mesh: trimesh.Trimesh | None
    doubts: tuple[str, ...]
    shown: tuple[ShownFrame, ...]

    @property
    def path_length(self) -> float:
        """Length of the camera's path in metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @functools.cached_property
    def surface_points(self) -> Float[np.ndarray, "n 3"]:
        """Points of the surface by the depth maps that were read, or of the mesh; none without either."""
        points = np.zeros((0, 3))
        if self.quantiles is not None:
            settings = FusionSettings()
            plan = plan_fusion(self.capture, settings)
            readings = Readings(self.capture, spread(plan.indices, SAMPLE_COUNT), settings.confidence)
            near = [
                camera.unproject(depth)[(depth > NEAR_LIMIT) & (depth < plan.far)] for depth, camera, _ in readings
            ]
            points = np.concatenate(near)
        elif self.mesh is not None:
            points = np.asarray(self.mesh.vertices)
        return points[:: max(1, len(points) // MOST_PLAN_POINTS)]

    def lines(self) -> Iterator[tuple[str, str]]:
        """Names and values, for people."""
        capture, count = self.capture, len(self.capture)
        yield "format", capture.format
        rate = f", {(count - 1) / self.seconds:.3g} a second over {self.seconds:.3g} s" if self.seconds > 0 else ""
        yield "frames", f"{count}{rate}"
        yield "pictures", ", ".join(f"{w}x{h}" for w, h in dict.fromkeys(self.sizes))
        if self.exposures:
            low, high = (1e3 * f(self.exposures) for f in (min, max))
            yield "exposure", (f"{low:.3g} ms" if low == high else f"{low:.3g} to {high:.3g} ms")
        yield "camera path", f"{self.path_length:.3g} m within {_span(self.positions)}"
        if len(self.surface_points):
            yield "surface", _span(np.quantile(self.surface_points, SPAN_QUANTILES, axis=0))
        yield "up", " ".join(f"{x:.3f}" for x in capture.up)
        if self.depth_size is None or self.coverage is None or self.quantiles is None:
            yield "depth", "none"
        else:
            low, middle, high = self.quantiles
            yield (
                "depth",
                f"{capture.depth_count} maps of {self.depth_size[0]}x{self.depth_size[1]} ({capture.sensor.name}), "
                f"{100 * self.coverage.measured:.0f} % of the pixels, {low:.2g} to {high:.2g} m, "
                f"median {middle:.2g} m",
            )
        if self.mesh is None:
            yield "mesh", "none"
        else:
            yield "mesh", f"{len(self.mesh.faces)} triangles, {self.mesh.area:.3g} m²"
            if self.coverage is not None:
                yield (
                    "mesh to depth",
                    f"{self.coverage.distance:.3g} m (median); the mesh has {100 * self.coverage.covered:.0f} % of "
                    "the depth readings",
                )
                if self.coverage.covered < ENOUGH_COVERAGE:
                    yield "note", "relighting fuses the depth too, and takes that if it has clearly more"
        for remark in capture.remarks:
            yield "note", remark
        for doubt in self.doubts:
            yield "doubtful", doubt


def inspect(capture: Capture, *, progress: bool = True) -> Inspection:
    """Inspect a capture; a dozen of its pictures and depth maps are read."""
    doubts = list(capture.faults)
    sizes, exposures, times, shown = [], [], [], []
    samples = spread(range(len(capture)), SAMPLE_COUNT)
    pictured = spread(samples, SHOWN_COUNT)

    def read(index: int) -> Frame | InputError:
        try:
            return capture[index]
        except InputError as error:
            return error

    frames = prefetch(read, samples, depth=cores(), threads=cores())
    for index, frame in zip(
        samples, tqdm(frames, "reading", total=len(samples), disable=not progress, unit="frame")
    ):
        if isinstance(frame, InputError):
            doubts.append(str(frame))
            continue
        sizes.append((frame.camera.intrinsics.width, frame.camera.intrinsics.height))
        times.append(frame.time)
        if index in pictured:
            shown.append(ShownFrame.of(frame, times_known=capture.times_known))
        if frame.exposure is not None:
            exposures.append(frame.exposure)
    if not sizes:
        raise InputError(f"{capture.name}: none of the frames can be read; the first: {doubts[-len(samples)]}")
    cameras = [capture.camera(index) for index in range(len(capture))]
    positions = np.array([camera.origin for camera in cameras])
    mesh = None
    try:
        mesh = capture.mesh()
    except InputError as error:
        doubts.append(str(error))
    coverage = depth_size = quantiles = None
    if capture.depth_count:
        depths = []
        for index in spread(range(capture.depth_count), SAMPLE_COUNT):
            try:
                depths.append(capture.depth_reading(index).depth)
            except InputError as error:
                if str(error) not in doubts:  # a picture with its depth may be one file
                    doubts.append(str(error))
        depth = np.concatenate([np.zeros(0), *(one.ravel() for one in depths)])
        positive = depth[np.isfinite(depth) & (depth > 0)]
        if len(positive) and not USUAL_DEPTH[0] < (median := float(np.median(positive))) < USUAL_DEPTH[1]:
            doubts.append(f"the median depth is {median:.2g} m; is the unit of the depth maps right?")
        depth = positive[positive > NEAR_LIMIT]
        if len(depth):
            depth_size = depths[0].shape[1], depths[0].shape[0]
            low, middle, high = (float(q) for q in np.quantile(depth, (0.01, 0.5, 0.99)))
            quantiles = low, middle, high
            coverage = coverage_of(capture, mesh)
        elif not len(positive):
            doubts.append("the depth maps have no readings")
    doubts += _doubts(capture, cameras, mesh, coverage)
    seconds = max(times) - min(times) if capture.times_known else 0.0
    return Inspection(
        capture,
        sizes,
        exposures,
        seconds,
        positions,
        depth_size,
        coverage,
        quantiles,
        mesh,
        tuple(doubts),
        tuple(shown),
    )


def _doubts(
    capture: Capture, cameras: Sequence[Camera], mesh: trimesh.Trimesh | None, coverage: Coverage | None
) -> Iterator[str]:
    steps = np.linalg.norm(np.diff([camera.origin for camera in cameras], axis=0), axis=1)
    if len(steps) and steps.max() > LONGEST_STEP:
        yield f"the camera jumps by {steps.max():.3g} m before frame {steps.argmax() + 1}"
    if len(steps) and steps.sum() < 0.05:
        yield "the camera hardly moves; a mesh of one view has holes behind everything"
    lens = cameras[0].intrinsics
    if not all(0.25 < c / side < 0.75 for c, side in ((lens.cx, lens.width), (lens.cy, lens.height))):
        yield (
            f"the principal point lies at ({lens.cx:.4g}, {lens.cy:.4g}) in pictures of {lens.width}x{lens.height}"
            "; are the intrinsics of another size?"
        )
    if np.mean([-camera.pose[:3, 1] @ capture.up for camera in cameras]) < UPSIDE_DOWN_COSINE:
        yield "the pictures are upside down, or up points down"
    if not capture.metric:
        yield "the unit of length is not known; give --scale, metres in one unit"
    if mesh is None and not capture.depth_count:
        yield "neither depth nor a mesh; give one with --mesh FILE"
    if mesh is not None and not 0.1 < max(mesh.extents) < 1000:
        yield f"the mesh spans {max(mesh.extents):.3g} m; is it in metres?"
    if mesh is None or coverage is None:
        return
    if coverage.hit < LEAST_OVERLAP:
        yield f"the mesh is met by {100 * coverage.hit:.0f} % of the depth readings; same axes and units?"
    elif coverage.distance > READING_TOLERANCE[0] + 2 * READING_TOLERANCE[1]:
        yield f"mesh and depth lie {coverage.distance:.3g} m apart (median); are both in the same axes and units?"
    elif coverage.covered < LOW_COVERAGE:
        yield f"the mesh has only {100 * coverage.covered:.0f} % of the depth readings"


def relight_command(path: Path | None, capture: Capture, *, scale: float | None = None, quick: bool = False) -> str:
    """Command that relights a capture.

    Args:
        path: of the capture; None for the built-in room.
        scale: metres in one unit of its poses.
        quick: relight a few of its frames, and those small.
    """
    words = ["hyjax", "relight"]
    if path is not None:
        words += ["--capture", shlex.quote(str(path))]
    if scale is not None:
        words += ["--scale", f"{scale:g}"]
    elif not capture.metric:
        words += ["--scale", "METRES_IN_ONE_UNIT"]
    if not capture.depth_count and not capture.has_mesh:
        words += ["--mesh", "FILE"]
    if quick and len(capture) > QUICK_COUNT:
        words += ["--frames", ",".join(map(str, spread(range(len(capture)), QUICK_COUNT)))]
    if quick and max(shape := capture.camera(0).intrinsics.shape) > QUICK_SIDE:
        height, width = (round(QUICK_SIDE * side / max(shape)) for side in shape)
        words += ["--size", f"{width}x{height}"]
    return " ".join(words)


def points_from_above(inspection: Inspection) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "m 2"]]:
    """Plan of surface points and camera positions: metres along two horizontal axes."""
    axes = orthonormal_frame(inspection.capture.up)[:2].T
    return inspection.surface_points @ axes, inspection.positions @ axes


def _span(points: Float[np.ndarray, "n 3"]) -> str:
    """Range of points along each axis, in words."""
    lows, highs = points.min(axis=0), points.max(axis=0)
    return ", ".join(f"{axis} {low:.2f} to {high:.2f}" for axis, low, high in zip("xyz", lows, highs)) + " m"
