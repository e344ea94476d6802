"""Alignment of a capture's frames: registration of depth maps removes the drift of a phone's tracking.

A phone's poses are off by centimetres from one end of a walk to the other. Fused as they are, thin things vanish
and borders swell, and the surface lies beside the picture. Half of the depth maps are registered to each other. A
tracker drifts and does not jump from frame to frame, so their corrections are smoothed along the walk, and those of
all frames lie between them. How much is chosen by the agreement of every other pair of neighbouring pictures
(`hyjax.geometry.picture_agreement`), which knows nothing of the surface. The poses stay as they are unless the
other pairs agree better, and the surface covers the other half of the depth maps no worse.
"""

import contextlib
import dataclasses
import functools
import itertools
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.data.capture import Capture, DerivedCapture, Frame
from hyjax.data.frames import shrink, small_frame, spread
from hyjax.geometry.camera import Camera
from hyjax.geometry.coverage import Coverage
from hyjax.geometry.depth_map import DepthReading
from hyjax.geometry.depth_sensor import PHONE_LIDAR
from hyjax.geometry.picture_agreement import PosedPicture, agreement, posed_picture
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.registration import register
from hyjax.geometry.tsdf import fuse
from hyjax.scene.fusion import FusionPlan, Readings, plan_fusion
from hyjax.scene.fusion_settings import MAX_FUSED_FRAMES, FusionSettings
from hyjax.scene.photo_light import FRAME_COUNT
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError
from hyjax.util.files import digest

VERSION = 3
"""Version of the alignment. Add one when its poses change."""
FEWEST_MAPS = 8
"""Fewest depth maps to align."""
LEAST_GAIN = 0.005
"""Least gain of coverage of held-out depth by aligned poses, where no pictures can judge them."""
LEAST_AGREEMENT_GAIN = 0.01
"""Least gain of the mean agreement of held-out pairs of pictures by aligned poses."""
MOST_PICTURES, PICTURE_WIDTH = 2 * FRAME_COUNT - 1, 320
"""Most pictures whose agreement is measured, the photo's light's among them, and their longer side in pixels."""
FEWEST_PAIRS = 6
"""Fewest pairs of pictures that can judge poses."""
SMOOTHING_WIDTHS = (2.0, 4.0, 8.0, 16.0)
"""Standard deviations, in depth maps of the fusion, of the Gaussian that smooths corrections along the walk."""
DEFAULT_WIDTH = 4.0
"""Standard deviation where no pictures can judge the poses."""
_log = logging.getLogger(__name__)


def aligned(capture: Capture, settings: FusionSettings, progress: bool = True) -> Capture:
    """Align the poses of a capture; return it as it is where that is not wanted, not possible or no better."""
    wanted = settings.align == "yes" or (settings.align == "auto" and capture.sensor == PHONE_LIDAR)
    if not wanted or isinstance(capture, AlignedCapture):
        return capture
    if (count := capture.depth_count) < FEWEST_MAPS:
        _say_unaligned(capture, settings, f"alignment needs {FEWEST_MAPS} depth maps, there are {count}")
        return capture
    most = min(settings.fuse_frames or MAX_FUSED_FRAMES, MAX_FUSED_FRAMES)
    try:
        plan = plan_fusion(capture, dataclasses.replace(settings, fuse_frames=most))
        corrections = cached_arrays(
            cache_folder() / f"alignment-{digest([f'{VERSION}', capture.fingerprint, repr(plan)])}.npz",
            functools.partial(_corrections, len(plan.indices[::2])),
            lambda: _align(capture, plan, progress),
        )
    except InputError as error:
        _log.warning("%s: poses are taken as they are: %s", capture.name, error)
        return capture
    if not len(corrections):
        _say_unaligned(capture, settings, "neighbouring pictures and depth maps agree no better by aligned ones")
        return capture
    return AlignedCapture(capture, np.array(plan.indices[::2]), corrections)


def _say_unaligned(capture: Capture, settings: FusionSettings, reason: str) -> None:
    """Say that the poses stay as they are; as a warning where alignment was asked for."""
    level = logging.WARNING if settings.align == "yes" else logging.INFO
    _log.log(level, "%s: poses are taken as they are: %s", capture.name, reason)


def _corrections(count: int, arrays: Arrays) -> Float[np.ndarray, "n 4 4"]:
    corrections = arrays["corrections"]
    if corrections.shape not in ((0, 4, 4), (count, 4, 4)) or not np.all(np.isfinite(corrections)):
        raise ValueError("not the corrections of these depth maps")
    return corrections


def _align(capture: Capture, plan: FusionPlan, progress: bool) -> Arrays:
    """Corrections of the poses of every other depth map as motions; none if they are no better."""
    readings, indices = list(Readings(capture, plan.indices, plan.confidence)), np.array(plan.indices)

    tracked: dict[bytes, trimesh.Trimesh] = {}

    def fused(maps: Sequence[DepthReading]) -> trimesh.Trimesh:
        poses = np.stack([reading.camera.pose for reading in maps]).tobytes()
        if poses in tracked:
            return tracked[poses]
        mesh = fuse(maps, plan.voxel, plan.truncation, plan.far, plan.min_weight, progress=False)
        if not tracked:  # the first is the one as tracked, which is asked for again
            tracked[poses] = mesh
        return mesh

    def coverage(maps: Sequence[DepthReading]) -> float:
        """Coverage of every other depth map by the surface of the rest."""
        return Coverage.of(RayCaster(fused(maps[::2])), maps[1::2]).covered

    with posed_pictures(capture, plan.far) as pictures:
        moved = register(readings[::2], fused, plan.far, progress=progress)
        posed = pictures()
    motions = np.stack(
        [new.camera.pose @ np.linalg.inv(old.camera.pose) for new, old in zip(moved, readings[::2], strict=True)]
    )
    origins = np.stack([reading.camera.origin for reading in readings[::2]])
    candidates = {width: smoothed(motions, origins, width) for width in SMOOTHING_WIDTHS}
    captures = {width: AlignedCapture(capture, indices[::2], found) for width, found in candidates.items()}
    scores = agreements(posed, [capture, *captures.values()])
    width, judged, none = DEFAULT_WIDTH, len(scores) >= FEWEST_PAIRS, {"corrections": np.zeros((0, 4, 4))}
    if judged:
        before, *after = scores[1::2].mean(axis=0)
        best = int(np.argmax(scores[::2, 1:].mean(axis=0)))
        width = SMOOTHING_WIDTHS[best]
        _log.info(
            "%s: neighbouring pictures agree to %.2f as tracked and to %.2f as aligned",
            capture.name,
            before,
            after[best],
        )
        if after[best] < before + LEAST_AGREEMENT_GAIN:
            return none
    corrected = [
        reading._replace(camera=captures[width].corrected(reading.camera, float(index)))
        for reading, index in zip(readings, indices, strict=True)
    ]
    if coverage(corrected) < coverage(readings) + (0.0 if judged else LEAST_GAIN):
        return none
    return {"corrections": candidates[width]}


def smoothed(
    motions: Float[np.ndarray, "n 4 4"], origins: Float[np.ndarray, "n 3"], width: float
) -> Float[np.ndarray, "n 4 4"]:
    """Motions smoothed along their order by a Gaussian; shifts are those of the places `origins`.

    Args:
        width: standard deviation, in motions of the whole fusion, of which these are every other.
    """
    from scipy import ndimage  # SciPy is slow to load

    shifts = np.einsum("nij,nj->ni", motions[:, :3, :3], origins) + motions[:, :3, 3] - origins
    turns = Rotation.from_matrix(motions[:, :3, :3]).as_rotvec()
    shifts, turns = (ndimage.gaussian_filter1d(x, 0.5 * width, axis=0, mode="nearest") for x in (shifts, turns))
    found = np.tile(np.eye(4), (len(motions), 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    found[:, :3, 3] = origins + shifts - np.einsum("nij,nj->ni", found[:, :3, :3], origins)
    return found


@contextlib.contextmanager
def posed_pictures(capture: Capture, far: float) -> Iterator[Callable[[], dict[int, PosedPicture]]]:
    """Pictures spread over a capture that have a depth map of their moment, by their positions.

    Readings beyond `far` metres do not count. Pictures are read on another thread during the block, which gets a
    function that waits for them.
    """
    count = len(capture)
    again = spread(range(count), FRAME_COUNT)

    def read(index: int) -> PosedPicture | None:
        position = capture.depth_position(index)
        if position != int(position):
            return None
        try:
            picture = shrink(small_frame(capture, index, keep=index in again), PICTURE_WIDTH)
            return posed_picture(picture.image, picture.camera, capture.depth_reading(int(position)), far)
        except InputError as error:
            _log.info("poses are judged without frame %d: %s", index, error)
            return None

    pool = ThreadPoolExecutor(1, thread_name_prefix="posed-pictures")
    try:
        coming = {index: pool.submit(read, index) for index in spread(range(count), MOST_PICTURES)}
        yield lambda: {index: found for index, future in coming.items() if (found := future.result()) is not None}
    finally:
        pool.shutdown(cancel_futures=True)


def agreements(pictures: dict[int, PosedPicture], captures: Sequence[Capture]) -> Float[np.ndarray, "p n"]:
    """Agreement of each pair of neighbouring pictures by the poses of each capture; pairs that all can tell."""
    pairs = []
    for (first, one), (second, other) in itertools.pairwise(pictures.items()):
        posed = [(one.moved(c.camera(first).pose), other.moved(c.camera(second).pose)) for c in captures]
        found = [agreement(*pair) for pair in posed]
        if None not in found:
            pairs.append(found)
    return np.array(pairs, float).reshape(-1, len(captures))


class AlignedCapture(DerivedCapture):
    """Capture with corrected poses.

    Args:
        indices: of the depth maps whose corrections are known, ascending.
        corrections: motions of the world that correct their poses; between them they are interpolated.
    """

    def __init__(
        self, capture: Capture, indices: Float[np.ndarray, "n"], corrections: Float[np.ndarray, "n 4 4"]
    ) -> None:
        super().__init__(capture)
        self._indices, self._corrections = np.asarray(indices, float), corrections

    @property
    def fingerprint(self) -> str:
        return digest([self.source.fingerprint, np.round(self._corrections, 6).tobytes().hex()])

    @property
    def moved(self) -> Float[np.ndarray, "n"]:
        """Distances that the cameras of the frames have moved, in metres."""
        count = len(self)
        return np.array(
            [np.linalg.norm(self.camera(k).origin - self.source.camera(k).origin) for k in range(count)]
        )

    def __getitem__(self, index: int) -> Frame:
        frame = self.source[index]
        return dataclasses.replace(frame, camera=self.corrected(frame.camera, self._position(index)))

    @property
    def picture_source(self) -> Capture:
        return self.source.picture_source

    def camera(self, index: int) -> Camera:
        return self.corrected(self.source.camera(index), self._position(index))

    def depth_reading(self, index: int) -> DepthReading:
        reading = self.source.depth_reading(index)
        return reading._replace(camera=self.corrected(reading.camera, float(index)))

    def _position(self, index: int) -> float:
        return self.source.depth_position(range(len(self))[index])

    def corrected(self, camera: Camera, position: float) -> Camera:
        """Camera of the source with its correction at a position among the depth maps."""
        right = int(np.clip(np.searchsorted(self._indices, position), 1, max(len(self._indices) - 1, 1)))
        pair = self._corrections[[right - 1, min(right, len(self._corrections) - 1)]]
        first, second = self._indices[right - 1], self._indices[min(right, len(self._indices) - 1)]
        share = float(np.clip((position - first) / max(second - first, 1e-9), 0.0, 1.0))
        motion = np.eye(4)
        turns = Rotation.from_matrix(pair[:, :3, :3])
        between = (turns[0].inv() * turns[1]).as_rotvec()
        motion[:3, :3] = (turns[0] * Rotation.from_rotvec(share * between)).as_matrix()
        # Places are mixed at the camera: the world's origin may be far away.
        at_camera = pair[:, :3, :3] @ camera.origin + pair[:, :3, 3]
        motion[:3, 3] = (1 - share) * at_camera[0] + share * at_camera[1] - motion[:3, :3] @ camera.origin
        return Camera(camera.intrinsics, motion @ camera.pose)
