"""Registration of depth maps to the surface that they make together: poses without the drift of a phone's tracking.

Frame to model, as in KinectFusion: depth maps are fused, each is moved to fit the surface (point to plane, points
matched along the camera's rays), they are fused again, and so on. What all have moved together is taken back, so
that the world stays where it was.

Sources: Newcombe et al., "KinectFusion", ISMAR 2011 (frame to model, projective association); Chen & Medioni,
"Object modelling by registration of multiple range images", IVC 1992 (point to plane).
"""

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import DepthReading, clean_depth
from hyjax.geometry.raycast import RayCaster
from hyjax.util.progress import StepBar

MATCHED_READINGS = 4000
"""Readings of a depth map that are matched."""
FEWEST_MATCHES = 500
"""Matches below which a depth map stays where it is."""
ITERATIONS = 6
GATE = 0.1
"""Metres between a reading and the surface beyond which they do not belong together."""
NOISE_METRES = 0.02
"""Metres off the surface at which a reading has half its weight (Cauchy's weight)."""
DAMPING = 1e-5
"""Keeps directions along which nothing is known (a floor's own) from running away; per match, m²."""
MOST_SHIFT, MOST_TURN = 0.15, 0.1
"""Metres and radians that a pose may be corrected by."""
Pose = Float[np.ndarray, "4 4"]


def register(
    readings: Sequence[DepthReading],
    fuse_readings: Callable[[Sequence[DepthReading]], trimesh.Trimesh],
    far: float,
    rounds: int = 3,
    progress: bool = True,
) -> list[DepthReading]:
    """Depth maps with poses that fit each other, see `registered`."""
    current = list(readings)
    with StepBar[None](desc="registering", total=rounds * len(readings), disable=not progress, unit="frame") as bar:
        for _ in range(rounds):
            caster, moved = RayCaster(fuse_readings(current)), []
            for now, first in zip(current, readings, strict=True):
                moved.append(registered(now, caster, far, first.camera.pose))
                bar.update()
            drift = mean_motion([m.camera.pose @ np.linalg.inv(r.camera.pose) for m, r in zip(moved, readings)])
            back = np.linalg.inv(drift)
            current = [_posed(reading, back @ reading.camera.pose) for reading in moved]
    return current


def registered(reading: DepthReading, caster: RayCaster, far: float, first: Pose | None = None) -> DepthReading:
    """A depth map moved to fit a surface; where it was if little of it is near, or if it would have to go far.

    Args:
        reading: the depth map with a pose that is nearly right.
        far: metres beyond which nothing is matched.
        first: pose that it must stay near; its own if None.
    """
    camera = reading.camera
    first = camera.pose if first is None else first
    depth = clean_depth(reading.depth, camera, far)
    usable = depth > 0 if reading.confidence is None else (depth > 0) & (reading.confidence >= 1)
    chosen = np.flatnonzero(usable)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(MATCHED_READINGS, len(chosen))).astype(int)]
    local = (Camera(camera.intrinsics, np.eye(4)).rays() * depth[..., None]).reshape(-1, 3)[chosen]
    pose = camera.pose
    for _ in range(ITERATIONS):
        step = _step(local, pose, caster)
        if step is None:
            return reading
        pose = step @ pose
    change = pose @ np.linalg.inv(first)
    at_camera = np.linalg.norm(pose[:3, 3] - first[:3, 3])
    if at_camera > MOST_SHIFT or np.linalg.norm(Rotation.from_matrix(change[:3, :3]).as_rotvec()) > MOST_TURN:
        return reading
    return _posed(reading, pose)


def _step(local: Float[np.ndarray, "n 3"], pose: Pose, caster: RayCaster) -> Pose | None:
    """Motion that brings points nearer to the planes that they were matched with; None without enough of them."""
    rays = local @ pose[:3, :3].T  # as long as the readings are far
    hits = caster.cast(pose[:3, 3], rays)
    scale = np.where(hits.hit, hits.distance, 1.0)
    apart = (scale - 1.0)[:, None] * rays
    near = hits.hit & (np.linalg.norm(apart, axis=1) < GATE)
    if near.sum() < FEWEST_MATCHES:
        return None
    normal = caster.interpolated_normals(hits)[near]
    point, off = (pose[:3, 3] + rays)[near], np.einsum("nk,nk->n", apart[near], normal)
    weight = 1.0 / (1.0 + (off / NOISE_METRES) ** 2)
    centre = point.mean(axis=0)
    jacobian = np.concatenate([np.cross(point - centre, normal), normal], axis=1)
    weighted = jacobian * weight[:, None]
    twist = np.linalg.solve(weighted.T @ jacobian + DAMPING * len(off) * np.eye(6), weighted.T @ off)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix()
    motion[:3, 3] = centre + twist[3:] - motion[:3, :3] @ centre
    return motion


def mean_motion(motions: Sequence[Pose]) -> Pose:
    """Mean of rigid motions that are small."""
    mean = np.eye(4)
    mean[:3, :3] = Rotation.from_matrix([m[:3, :3] for m in motions]).mean().as_matrix()
    mean[:3, 3] = np.mean([m[:3, 3] for m in motions], axis=0)
    return mean


def _posed(reading: DepthReading, pose: Pose) -> DepthReading:
    return reading._replace(camera=Camera(reading.camera.intrinsics, pose))
