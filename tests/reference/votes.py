"""Votes of a depth map in a volume by plain NumPy, voxel by voxel of a whole grid."""

import numpy as np

from hyjax.geometry.camera import Camera


def votes(
    places: np.ndarray, depth: np.ndarray, weight: np.ndarray, camera: Camera, voxel: float, truncation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted distances and weights at world points (n, 3); both 0 where the map has no vote."""
    pixel, far = camera.project(places)
    column, row = np.floor(np.nan_to_num(pixel, nan=-1.0)).T
    height, width = depth.shape
    seen = (far >= 0.1) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    row, column = (np.where(seen, x, 0).astype(int) for x in (row, column))
    reading = np.where(seen, depth[row, column], 0.0)
    distance = reading - far
    fade = np.clip((distance + truncation) / (truncation - voxel), 0.0, 1.0)
    vote = np.where(reading > 0, fade * weight[row, column], 0.0)
    return vote * np.clip(distance, -truncation, truncation), vote
