"""Volume that forgets: depth maps are averaged as they come, and old evidence gives way where they contradict it.

A fusion of finished captures averages all votes alike: a chair that was looked at for a minute would take another
minute to go. Here a voxel's weight is bounded, and a vote of the other sign meets no more than `MEMORY_VOTES`
votes like itself. The distances that the mesh was made of are kept too, to find the blocks that have changed.

Sources: Nießner et al., "Real-time 3D reconstruction at scale using voxel hashing", SIGGRAPH Asia 2013 (bounded
weights); Keller et al., "Real-time 3D reconstruction in dynamic scenes using point-based fusion", 3DV 2013 (points
that new frames look through lose their confidence); Fehr et al., "TSDF-based change detection for consistent
long-term dense reconstruction and dynamic object discovery", ICRA 2017.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.camera import Camera
from hyjax.geometry.tsdf import BLOCK_SIDE, Volume
from hyjax.geometry.voxels import voxel_coordinates, voxel_keys
from hyjax.util.errors import InputError

MOST_WEIGHT = 3.0
"""Largest weight of a voxel: three views head-on from one metre, or some thirty from three."""
MEMORY_VOTES = 8.0
"""Votes that old evidence counts for, at most, against one that contradicts it."""
CONTRADICTION = 0.5
"""Share of the truncation between the mean and a vote of the other sign from which the vote contradicts it."""
MIN_WEIGHT = 0.1
"""Least weight of a voxel that counts, as in `hyjax.geometry.tsdf.fuse`."""
TOLERANCE = 0.03
"""Share of the truncation that a distance may move before its block is meshed anew: 5 mm with voxels of 4 cm."""
UNSEEN_VALUE = 2.0
"""Value in place of a distance, where too little has been seen."""
MOST_BLOCKS = 60_000
"""Most blocks, of 8³ voxels each: 360 MB, enough for a flat of some 200 m² with voxels of 4 cm."""
KEPT_SHARE = 0.9
"""Share of `MOST_BLOCKS` that is left when those seen longest ago are dropped."""


class LiveVolume(Volume):
    """Signed distance in sparse blocks of voxels, with the list of changed blocks.

    Attributes:
        frames: depth maps that were integrated.

    Args:
        voxel: edge in metres.
        most_blocks: beyond so many the blocks that were seen longest ago are dropped.
    """

    def __init__(self, voxel: float, *, most_blocks: int = MOST_BLOCKS) -> None:
        if not (0 < voxel < np.inf and most_blocks > 0):
            raise InputError(f"live: need a voxel above 0 m and a block, got {voxel} and {most_blocks}")
        super().__init__(voxel, 4.0 * voxel)
        self.frames, self._most = 0, most_blocks
        self._meshed = np.zeros((0, BLOCK_SIDE**3), np.float32)  # what the mesh was made of
        self._touched = np.zeros(0, bool)
        self._seen = np.zeros(0, np.int64)  # the frame that each block was last seen in
        self._dropped = np.zeros((0, 3), np.int64)

    def integrate(self, depth: Float[np.ndarray, "h w"], camera: Camera, *rest: Any) -> None:
        """Add one depth map's votes; arguments as `Volume.integrate` has them."""
        self.frames += 1
        super().integrate(depth, camera, *rest)
        if self.count > self._most:
            self._drop(self.count - round(KEPT_SHARE * self._most))

    def take_changes(self) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
        """Blocks that have changed since they were last taken, which are taken with this.

        Returns:
            Their coordinates, and the largest change in each, as a share of the truncation.
        """
        slots = np.flatnonzero(self._touched[: self.count])
        self._touched[slots] = False
        weights = self._weights[slots]
        now = self._sums[slots]
        now /= np.maximum(weights, np.float32(1e-12)) * np.float32(self.truncation)
        now[weights <= MIN_WEIGHT] = UNSEEN_VALUE
        amount = np.abs(now - self._meshed[slots]).max(axis=1, initial=0.0)
        changed = amount > TOLERANCE
        self._meshed[slots[changed]] = now[changed]
        amounts = np.zeros(self.count, np.float32)
        amounts[slots[changed]] = amount[changed]
        amounts = amounts[self._slots]
        found = voxel_coordinates(self._keys[amounts > 0])
        dropped, self._dropped = self._dropped, self._dropped[:0]
        gone = np.full(len(dropped), np.float32(UNSEEN_VALUE))
        return np.concatenate([found, dropped]), np.concatenate([amounts[amounts > 0], gone])

    def distances(self, low: Int[np.ndarray, "3"], size: Int[np.ndarray, "3"]) -> Float[np.ndarray, "x y z"]:
        """Distances in a box of blocks, as last taken, as shares of the truncation; else `UNSEEN_VALUE`."""
        x, y, z = size
        coordinates = np.indices((x, y, z)).reshape(3, -1).T + low
        keys = voxel_keys(coordinates)
        place = np.minimum(np.searchsorted(self._keys, keys), max(self.count - 1, 0))
        found = self._keys[place] == keys if self.count else np.zeros(len(keys), bool)
        values = np.full((len(keys), BLOCK_SIDE**3), np.float32(UNSEEN_VALUE))
        values[found] = self._meshed[self._slots[place[found]]]
        cells = values.reshape(x, y, z, BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE).transpose(0, 3, 1, 4, 2, 5)
        return cells.reshape(x * BLOCK_SIDE, y * BLOCK_SIDE, z * BLOCK_SIDE)

    def meshed(self) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 512"]]:
        """Coordinates of all blocks, and their distances as last taken."""
        return voxel_coordinates(self._keys), self._meshed[self._slots]

    def _update(self, coordinates: Any, slots: Int[np.ndarray, "n"], *rest: Any) -> None:
        """Add the votes of one depth map to those before, as `Volume` counts them."""
        sums, weights = self._sums[slots], self._weights[slots]
        self._sums[slots] = self._weights[slots] = 0.0
        super()._update(coordinates, slots, *rest)
        vote = self._weights[slots]
        distance, mean = self._sums[slots], sums / np.maximum(weights, np.float32(1e-12))
        last = distance / np.maximum(vote, np.float32(1e-12))
        # Deeper than a voxel behind a surface a vote is faint and says little: it may be a thin board's other side.
        against = (last * mean < 0) & (np.abs(last - mean) > CONTRADICTION * self.truncation)
        against &= (last >= -self.voxel) & (vote > 0)
        kept = np.minimum(weights, np.where(against, MEMORY_VOTES * vote, np.float32(MOST_WEIGHT)))
        self._sums[slots] = mean * kept + distance
        self._weights[slots] = kept + vote
        self._touched[slots] = True
        self._seen[slots] = self.frames

    def _reserve(self, count: int) -> None:
        super()._reserve(count)
        missing = len(self._sums) - len(self._meshed)
        if missing:
            self._meshed = np.pad(self._meshed, ((0, missing), (0, 0)), constant_values=UNSEEN_VALUE)
            self._touched, self._seen = (np.pad(a, (0, missing)) for a in (self._touched, self._seen))

    def _drop(self, count: int) -> None:
        """Drop the blocks seen longest ago; those that are left move together."""
        seen = self._seen[self._slots]
        left = np.ones(self.count, bool)
        left[np.argsort(seen, kind="stable")[:count]] = False
        self._dropped = np.concatenate([self._dropped, voxel_coordinates(self._keys[~left])])
        slots = self._slots[left]
        for name in ("_sums", "_weights", "_meshed", "_touched", "_seen"):
            setattr(self, name, getattr(self, name)[slots])
        self._keys, self._slots, self.count = self._keys[left], np.arange(len(slots)), len(slots)
