"""Fusion of posed depth maps into a surface, through a truncated signed distance on sparse blocks of voxels.

Each depth map votes, in every voxel it sees, for the distance to the surface along its own axis; the votes are
averaged and the surface is where the average changes sign. Memory goes to blocks of 8³ voxels that some camera saw.

Symbols: a voxel's signed distance is positive in free space (towards the camera), negative behind the surface, and
cut off at ±truncation. Weights are in units of one view head-on from one metre.

Sources: Curless & Levoy, "A volumetric method for building complex models from range images", SIGGRAPH 1996 (the
running weighted mean, carving of free space); Nießner et al., "Real-time 3D reconstruction at scale using voxel
hashing", SIGGRAPH Asia 2013 (sparse blocks); weights after Newcombe et al., "KinectFusion", ISMAR 2011.
"""

import itertools
import logging
import os
import time
from collections.abc import Iterable, Iterator, Sized
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy import ndimage

from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import NEAR_LIMIT, PosedDepth, clean_depth, posed_depths, view_cosine
from hyjax.geometry.surface import extract_surface
from hyjax.geometry.voxels import voxel_coordinates, voxel_keys
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, remove
from hyjax.util.progress import StepBar

_log = logging.getLogger(__name__)
BLOCK_SIDE = 8
CHUNK = 256  # blocks that a thread takes at once
MAX_BLOCKS = 1 << 20  # 4 GiB of voxels
MAX_CANDIDATES = 8_000_000  # blocks in the box around one view
SAVE_INTERVAL = 30.0
"""Seconds between two checkpoints."""


@runtime_checkable
class Restartable(Protocol):
    """Frames that can be taken from any position on."""

    def start(self, first: int) -> Iterator[PosedDepth]: ...


def fuse(
    frames: Iterable[PosedDepth],
    voxel: float,
    truncation: float | None = None,
    max_depth: float = 4.0,
    min_weight: float = 0.1,
    progress: bool = True,
    *,
    checkpoint: Path | None = None,
) -> trimesh.Trimesh:
    """Surface seen by posed depth maps, as a mesh in world coordinates.

    The result does not depend on the frames' order beyond rounding. Frames are taken one at a time; memory goes to
    the space that they see, not to their number.

    Args:
        frames: frames with depth, `DepthReading`s, or pairs (depth in metres, its camera). Readings that are not
            finite, not positive or beyond `max_depth` are no readings. Those that the device is less sure of weigh
            less, by the square of their confidence.
        voxel: edge of a voxel in metres.
        truncation: half width of the band around the surface in metres; 4 voxels unless given.
        max_depth: metres.
        min_weight: least weight of a voxel; 1 is one view head-on from 1 m, 1/9 one from 3 m.
        checkpoint: file to keep what has been fused in, every half minute; a later call with the same frames
            goes on from it, and removes it in the end. Frames that are `Restartable` are not read again for it.
    """
    truncation = 4.0 * voxel if truncation is None else truncation
    if not (0 < voxel < truncation < max_depth and np.isfinite(max_depth)):
        raise InputError(
            f"fuse: need 0 < voxel < truncation < max depth, got {voxel}, {truncation} and {max_depth} m"
        )
    volume, done = load_volume(checkpoint, voxel, truncation)
    total = len(frames) if isinstance(frames, Sized) else None
    left = frames.start(done) if isinstance(frames, Restartable) else itertools.islice(frames, done, None)
    saved = time.monotonic()
    bar = StepBar(posed_depths(left), "fusing", total, initial=done, disable=not progress, unit="frame")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for count, (depth, camera, confidence) in enumerate(bar, start=done + 1):
            volume.integrate(depth, camera, max_depth, pool, confidence)
            if checkpoint is not None and time.monotonic() - saved > SAVE_INTERVAL:
                save_volume(checkpoint, volume, count)
                saved = time.monotonic()
    if checkpoint is not None:
        remove(checkpoint)
    if volume.count == 0:
        raise InputError(
            f"fuse: not one depth reading between {NEAR_LIMIT} and {max_depth} m; is their unit right?"
        )
    coordinates, distance, weight = volume.blocks()
    return extract_surface(coordinates, distance, weight > min_weight, voxel)


def save_volume(checkpoint: Path, volume: "Volume", count: int) -> None:
    """Keep a volume, and how many frames are in it; a folder that cannot be written costs a line, no more."""
    try:
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(checkpoint) as part, part.open("wb") as stream:
            np.savez(stream, count=count, **volume.arrays())  # type: ignore[arg-type]
    except (OSError, InputError) as error:
        _log.warning("the fusion is not kept meanwhile: %s", error)


def load_volume(checkpoint: Path | None, voxel: float, truncation: float) -> "tuple[Volume, int]":
    """Kept volume and the number of its frames; an empty one where none can be used."""
    if checkpoint is not None and checkpoint.is_file():
        try:
            with checkpoint.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
                count = int(kept["count"])
                return Volume.of_arrays(voxel, truncation, kept["keys"], kept["sums"], kept["weights"]), count
        except Exception as error:  # damage shows itself in a dozen ways
            _log.warning("%s: damaged (%s), the fusion begins anew", checkpoint, error)
    return Volume(voxel, truncation), 0


class Volume:
    """Sparse blocks of voxels with a weighted sum of distances and a sum of weights each.

    Voxel (i, j, k) of block (x, y, z) sits at world position voxel·(8x+i, 8y+j, 8z+k).
    """

    def __init__(self, voxel: float, truncation: float) -> None:
        self.voxel, self.truncation = voxel, truncation
        self.count = 0
        self._keys = np.zeros(0, dtype=np.int64)  # sorted
        self._slots = np.zeros(0, dtype=np.int64)  # where in the pool the block of each key is
        self._sums = np.zeros((0, BLOCK_SIDE**3), dtype=np.float32)
        self._weights = np.zeros((0, BLOCK_SIDE**3), dtype=np.float32)

    def arrays(self) -> dict[str, np.ndarray]:
        """All that it holds, for `of_arrays`."""
        return {"keys": self._keys, "sums": self._sums[self._slots], "weights": self._weights[self._slots]}

    @classmethod
    def of_arrays(
        cls, voxel: float, truncation: float, keys: np.ndarray, sums: np.ndarray, weights: np.ndarray
    ) -> "Volume":
        """A volume as it was."""
        kinds = keys.dtype == np.int64 and sums.dtype == weights.dtype == np.float32
        if not kinds or keys.ndim != 1 or not sums.shape == weights.shape == (len(keys), BLOCK_SIDE**3):
            raise InputError("keys, sums, weights: kinds or shapes are not those of a volume")
        volume = cls(voxel, truncation)
        volume.count, volume._keys, volume._slots = len(keys), keys, np.arange(len(keys))
        volume._sums, volume._weights = sums, weights
        return volume

    def blocks(self) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 512"], Float[np.ndarray, "n 512"]]:
        """Block coordinates, mean signed distance (as a share of the truncation, in [-1, 1]), weight."""
        sums, weights = self._sums[self._slots], self._weights[self._slots]
        sums /= np.maximum(weights, np.float32(1e-12)) * np.float32(self.truncation)
        return voxel_coordinates(self._keys), sums, weights

    def integrate(
        self,
        depth: Float[np.ndarray, "h w"],
        camera: Camera,
        max_depth: float,
        pool: ThreadPoolExecutor,
        confidence: Float[np.ndarray, "h w"] | None = None,
    ) -> None:
        """Add one depth map's votes. Readings of zero confidence do not vote."""
        if confidence is not None:
            depth = np.where(confidence > 0, depth, np.float32(0.0))
        depth = clean_depth(depth, camera, max_depth)
        if not depth.any():
            return
        # 1/z² as the sensor's noise, levelled off near the camera so that one close view does not outvote all.
        weight = view_cosine(depth, camera) / np.maximum(depth, 0.5) ** 2
        if confidence is not None:
            weight *= np.square(confidence, dtype=np.float32)
        depth, weight = (np.ascontiguousarray(values, np.float32) for values in (depth, weight))
        coordinates = _blocks_in_view(depth, camera, self.voxel * BLOCK_SIDE, self.truncation)
        slots = self._slots_of(voxel_keys(coordinates))
        chunks = [slice(start, start + CHUNK) for start in range(0, len(slots), CHUNK)]
        # Chunks are disjoint, so the result does not depend on how the threads take turns.
        list(pool.map(lambda part: self._update(coordinates[part], slots[part], depth, weight, camera), chunks))

    def _update(
        self,
        coordinates: Int[np.ndarray, "n 3"],
        slots: Int[np.ndarray, "n"],
        depth: Float[np.ndarray, "h w"],
        weight: Float[np.ndarray, "h w"],
        camera: Camera,
    ) -> None:
        from hyjax.geometry.fusion_kernel import add_votes  # compiled when first used

        turned = camera.pose[:3, :3].T
        project = camera.intrinsics.matrix @ np.column_stack([turned, -turned @ camera.origin])
        sizes = self.voxel, self.truncation, NEAR_LIMIT
        add_votes(coordinates, slots, depth, weight, project, *sizes, self._sums, self._weights)

    def _slots_of(self, keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Pool rows of blocks; blocks not yet there are added."""
        new = np.setdiff1d(keys, self._keys, assume_unique=True)
        if len(new):
            self._reserve(self.count + len(new))
            place = np.searchsorted(self._keys, new)
            self._keys = np.insert(self._keys, place, new)
            self._slots = np.insert(self._slots, place, np.arange(self.count, self.count + len(new)))
            self.count += len(new)
        return self._slots[np.searchsorted(self._keys, keys)]

    def _reserve(self, count: int) -> None:
        if count > MAX_BLOCKS:
            raise InputError(
                f"fuse: {count} blocks of {BLOCK_SIDE}³ voxels of {self.voxel} m are in view, more than the "
                f"{MAX_BLOCKS} that fit in memory; take a coarser voxel or a smaller max depth"
            )
        missing = count - len(self._sums)
        if missing > 0:
            grow = ((0, max(missing, len(self._sums) // 2)), (0, 0))
            self._sums, self._weights = np.pad(self._sums, grow), np.pad(self._weights, grow)


def _blocks_in_view(
    depth: Float[np.ndarray, "h w"], camera: Camera, size: float, truncation: float
) -> Int[np.ndarray, "n 3"]:
    """Coordinates of all blocks (edge `size`) between the camera and just behind the surface it sees."""
    k = camera.intrinsics
    far = depth.max() + truncation
    rim = np.array([[(u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0] for u in (0, k.width) for v in (0, k.height)])
    reach = np.concatenate([[camera.origin], camera.origin + far * rim @ camera.pose[:3, :3].T])
    low, high = np.floor(reach.min(axis=0) / size).astype(int), np.floor(reach.max(axis=0) / size).astype(int)
    if np.prod(high - low + 1.0) > MAX_CANDIDATES:
        raise InputError(
            f"fuse: one view spans {np.prod(high - low + 1.0):.0e} blocks of 8³ voxels of {size / BLOCK_SIDE:g} m; "
            "take a coarser voxel or a smaller max depth"
        )
    blocks = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
    local = ((blocks + 0.5) * size - camera.origin) @ camera.pose[:3, :3]
    radius = size * np.sqrt(3.0) / 2.0
    keep = (local[:, 2] > -radius) & (local[:, 2] < far + radius)
    blocks, local = blocks[keep], local[keep]
    # Side planes of the view pyramid: u ≥ 0 is x·fx + z·cx ≥ 0, and so on.
    planes = np.array([[k.fx, 0, k.cx], [-k.fx, 0, k.width - k.cx], [0, k.fy, k.cy], [0, -k.fy, k.height - k.cy]])
    planes = planes / np.linalg.norm(planes, axis=1, keepdims=True)
    keep = (local @ planes.T > -radius).all(axis=1)
    blocks, local = blocks[keep], local[keep]
    return blocks[local[:, 2] - radius - truncation < _farthest_around(depth, camera, local, radius)]


def _farthest_around(
    depth: Float[np.ndarray, "h w"], camera: Camera, centres: Float[np.ndarray, "n 3"], radius: float
) -> Float[np.ndarray, "n"]:
    """An upper bound of the depth over the pixels that each ball (camera axes) covers.

    Maxima over tiles of 16, 32, ... pixels; a ball looks at the level whose tiles are as wide as itself.
    """
    k = camera.intrinsics
    z = np.maximum(centres[:, 2] - radius, NEAR_LIMIT)
    column = k.cx + k.fx * centres[:, 0] / np.maximum(centres[:, 2], NEAR_LIMIT)
    row = k.cy + k.fy * centres[:, 1] / np.maximum(centres[:, 2], NEAR_LIMIT)
    level = np.ceil(np.log2(np.maximum(max(k.fx, k.fy) * radius / z / 16.0, 1.0))).astype(int)
    bound = np.full(len(centres), depth.max())
    tile = 16
    for number in range(level.max(initial=0) + 1):
        if tile >= min(depth.shape):
            break  # larger balls keep the maximum of the whole map
        rows, columns = (np.arange(0, n, tile) for n in depth.shape)
        largest = np.maximum.reduceat(np.maximum.reduceat(depth, rows, axis=0), columns, axis=1)
        tiles = ndimage.maximum_filter(largest, 3)
        here = level == number
        i = np.clip(row[here] // tile, 0, tiles.shape[0] - 1).astype(int)
        j = np.clip(column[here] // tile, 0, tiles.shape[1] - 1).astype(int)
        bound[here] = tiles[i, j]
        tile *= 2
    return bound
