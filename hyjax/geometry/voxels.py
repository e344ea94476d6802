"""Cells of a regular grid in space: one number for each, and the mean of the points in each."""

import numpy as np
from jaxtyping import Float, Int

from hyjax.util.errors import InputError

REACH = 1 << 20  # cells to either side of the origin


def voxel_keys(coordinates: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, "n"]:
    """One integer for the coordinates of a cell, in their lexicographic order; each must lie in ±`REACH`."""
    x, y, z = (coordinates.astype(np.int64) + REACH).T
    return (x << 42) | (y << 21) | z


def voxel_coordinates(keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n 3"]:
    """The inverse of `voxel_keys`."""
    return np.stack([keys >> 42, (keys >> 21) & 0x1FFFFF, keys & 0x1FFFFF], axis=-1) - REACH


class VoxelMean:
    """The mean of the points in each cell, of points that come in pieces. Memory goes to cells that have any."""

    def __init__(self, voxel: float) -> None:
        """`voxel` is a cell's edge in metres.

        Raises:
            InputError: it is not positive and finite.
        """
        if not (voxel > 0 and np.isfinite(voxel)):
            raise InputError(f"voxel: must be > 0 metres, got {voxel:g}")
        self._voxel = voxel
        self._keys = np.zeros(0, np.int64)  # sorted
        # Within its cell, in cells: the sums stay small and single precision is enough.
        self._sums = np.zeros((0, 3), np.float32)
        self._counts = np.zeros(0, np.float32)

    def add(self, points: Float[np.ndarray, "n 3"]) -> None:
        """Add finite points in metres.

        Raises:
            InputError: a point lies a million cells from the origin or further.
        """
        scaled = points.astype(np.float64) / self._voxel
        cells = np.floor(scaled)
        if np.abs(cells).max(initial=0) >= REACH:
            raise InputError(
                f"points reach {np.abs(points).max():.3g} m from the origin; with voxels of {self._voxel:g} m they "
                f"may reach {REACH * self._voxel:.3g} m; are they in metres?"
            )
        keys = np.concatenate([self._keys, voxel_keys(cells)])
        sums = np.concatenate([self._sums, (scaled - cells).astype(np.float32)])
        counts = np.concatenate([self._counts, np.ones(len(points), np.float32)])
        order = np.argsort(keys, kind="stable")  # which merges what is sorted already
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        self._keys = keys[first]
        self._sums = np.add.reduceat(sums[order], first, axis=0)
        self._counts = np.add.reduceat(counts[order], first)

    def points(self) -> Float[np.ndarray, "n 3"]:
        """The means in metres, float32, in the order of their cells."""
        means = voxel_coordinates(self._keys) + self._sums / self._counts[:, None]
        return (means * self._voxel).astype(np.float32)
