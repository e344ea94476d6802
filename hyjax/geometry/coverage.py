"""Coverage of depth maps by a mesh: share of their readings that it has, and its distance to them."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import NEAR_LIMIT, READING_TOLERANCE, DepthReading
from hyjax.geometry.raycast import RayCaster

ROWS = 60
"""Rays of a depth map, from top to bottom."""


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Agreement of a mesh and depth maps.

    Attributes:
        measured: share of the pixels that have a reading.
        covered: share of these in which the mesh lies within `READING_TOLERANCE` of the reading.
        hit: share of these in which there is any mesh.
        distance: median of the distance between reading and mesh along the camera's axis in metres, where there is
            mesh; NaN if there is none anywhere.
        error: the same of the covered readings alone: neither holes nor what was not scanned count.
    """

    measured: float
    covered: float
    hit: float
    distance: float
    error: float

    @classmethod
    def of(cls, caster: RayCaster | None, readings: Iterable[DepthReading]) -> "Coverage":
        """Coverage of depth maps by a mesh; a few thousand pixels of each are looked at.

        Args:
            caster: of the mesh; None where there is none, which covers nothing.
        """
        pixels = read = hit = 0
        distances, errors = [], []
        for depth, camera, confidence in readings:
            rows = min(ROWS, depth.shape[0])
            columns = max(1, round(rows * depth.shape[1] / depth.shape[0]))
            small = camera.intrinsics.resize(rows, columns)
            row, column = (
                ((np.arange(few) + 0.5) * many / few).astype(int)
                for few, many in ((rows, depth.shape[0]), (columns, depth.shape[1]))
            )
            measured = depth[np.ix_(row, column)]
            valid = np.isfinite(measured) & (measured > NEAR_LIMIT)
            if confidence is not None:
                valid &= confidence[np.ix_(row, column)] > 0
            rays = Camera(small, camera.pose).rays()[valid]
            found = np.full(len(rays), np.inf)
            if caster is not None:
                found = caster.cast(camera.origin, rays).distance  # rays have unit depth
            error = np.abs(found - measured[valid])
            pixels, read = pixels + valid.size, read + len(rays)
            errors.append(error[error < READING_TOLERANCE[0] + READING_TOLERANCE[1] * measured[valid]])
            hit += int(np.isfinite(found).sum())
            distances.append(error[np.isfinite(error)])
        every, near = (np.concatenate(found) if found else np.zeros(0) for found in (distances, errors))
        distance, error = (float(np.median(found)) if len(found) else float("nan") for found in (every, near))
        return cls(read / max(pixels, 1), len(near) / max(read, 1), hit / max(read, 1), distance, error)
