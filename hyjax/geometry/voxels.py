"""Cells of a regular grid in space, a number for each."""

import numpy as np
from jaxtyping import Int

REACH = 1 << 20  # cells to either side of the origin


def voxel_keys(coordinates: Int[np.ndarray, "n 3"]) -> Int[np.ndarray, "n"]:
    """One integer for the coordinates of a cell, in their lexicographic order; each must lie in ±`REACH`."""
    x, y, z = (coordinates.astype(np.int64) + REACH).T
    return (x << 42) | (y << 21) | z


def voxel_coordinates(keys: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n 3"]:
    """The inverse of `voxel_keys`."""
    return np.stack([keys >> 42, (keys >> 21) & 0x1FFFFF, keys & 0x1FFFFF], axis=-1) - REACH
