"""Kernel of the fusion that adds the votes of a depth map to blocks of voxels."""

import numpy as np

from hyjax.util.compiled import compiled


@compiled("void(i8[:,::1], i8[::1], f4[:,::1], f4[:,::1], f8[:,::1], f8, f8, f8, f4[:,::1], f4[:,::1])")
def add_votes(
    coordinates: np.ndarray,
    slots: np.ndarray,
    depth: np.ndarray,
    weight: np.ndarray,
    project: np.ndarray,
    voxel: float,
    truncation: float,
    near: float,
    sums: np.ndarray,
    weights: np.ndarray,
) -> None:
    """Add a vote to each voxel that a depth map sees, weighted distances to `sums` and weights to `weights`.

    Args:
        coordinates: numbers of the blocks along the world's axes; block 0 begins at the origin.
        slots: rows of the blocks in `sums` and `weights`, which have a column for each voxel.
        depth: metres, 0 for none.
        weight: weight of each reading.
        project: (3, 4), from the world to homogeneous pixel coordinates, the third of which is the depth.
        voxel, truncation: edge of a voxel, and half the width of the band around the surface; metres.
        near: least depth of a voxel, metres.
    """
    side = round(sums.shape[1] ** (1.0 / 3.0))
    height, width = depth.shape
    fade = 1.0 / (truncation - voxel)
    step_u, step_v, step_w = voxel * project[0, 2], voxel * project[1, 2], voxel * project[2, 2]
    for n in range(len(slots)):
        slot, cell = slots[n], 0
        z = voxel * side * coordinates[n, 2]
        for i in range(side):
            x = voxel * (side * coordinates[n, 0] + i)
            for j in range(side):
                y = voxel * (side * coordinates[n, 1] + j)
                u = project[0, 0] * x + project[0, 1] * y + project[0, 2] * z + project[0, 3]
                v = project[1, 0] * x + project[1, 1] * y + project[1, 2] * z + project[1, 3]
                w = project[2, 0] * x + project[2, 1] * y + project[2, 2] * z + project[2, 3]
                for k in range(side):
                    far = w + k * step_w
                    inverse = 1.0 / far
                    column, row = (u + k * step_u) * inverse, (v + k * step_v) * inverse
                    if far >= near and 0.0 <= column < width and 0.0 <= row < height:
                        reading = depth[int(row), int(column)]
                        distance = reading - far
                        # It fades behind the surface, from one voxel on, to leave a thin wall's far side.
                        share = min((distance + truncation) * fade, 1.0)
                        if reading > 0.0 and share > 0.0:
                            vote = share * weight[int(row), int(column)]
                            sums[slot, cell] += min(distance, truncation) * vote
                            weights[slot, cell] += vote
                    cell += 1
