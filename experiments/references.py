"""The surface that judges the others: accurate, cleaned, and only where it can be relied on.

A raw fusion at 2 cm is full of bumps and crevices of its own, which a perceptual metric takes for structure: it
would prefer a bumpy filter to a right one. So a fused reference has its normals
smoothed a little (docs/results/paper.md has how much is good), and pixels do not count where

- it has no surface,
- its depth is off from the frame's own depth reading by more than `hyjax.geometry.depth_map.READING_TOLERANCE`,
- it is seen at a cosine below `GRAZING`, or
- its normals turn by more than `BUMP` when they are smoothed further: a bump, or a crease that a fusion rounds off.

The built-in room's true mesh is taken as it is. Laser scans are taken as they are where the depth camera has a
reading that agrees: not every venue's are aligned with the captures."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool

from experiments.laser_scans import load_laser_scans
from hyjax.data.capture import Capture, Frame
from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import confirmed
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.surface import relax, with_normals
from hyjax.light.gbuffer import GBuffer
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.surfaces import surface_of
from hyjax.util.errors import InputError, did_you_mean

WORDS = ("true", "laser", "fused")
VOXEL = 0.02  # metres, of a fusion
LASER_VOXEL = 0.005  # metres: laser points are thinned to one in each such cube
RELAXING, SMOOTHING = 0, 4  # passes over the vertices and over the normals, see docs/results/paper.md
BUMP_PASSES = 20
BUMP = np.deg2rad(20.0)
GRAZING = 0.15


@dataclasses.dataclass(frozen=True)
class Reference:
    """An accurate surface.

    Attributes:
        description: what it is, in a few words.
        geometry: the mesh itself; of laser scans it consists of discs.
        gbuffer: what a camera sees of it.
        smoothed: the same with normals smoothed further, to find bumps; None if it is relied on as it is.
        measured: whether it is checked against the frames' own depth.
        unread: whether it is relied on where that has no reading.
    """

    description: str
    geometry: trimesh.Trimesh
    gbuffer: Callable[[Camera], GBuffer]
    smoothed: Callable[[Camera], GBuffer] | None = None
    measured: bool = True
    unread: bool = True

    def reliable(self, frame: Frame, camera: Camera, seen: GBuffer) -> Bool[np.ndarray, "h w"]:
        """Pixels where the reference may judge.

        Args:
            frame: as captured, with its depth.
            camera: of the picture that is judged.
            seen: what `camera` sees of the reference.
        """
        valid = np.asarray(seen.hit).copy()
        if self.measured and frame.depth is not None:
            valid &= confirmed(frame, np.asarray(seen.position), unread=self.unread)
        if self.smoothed is not None:
            normal, rays = np.asarray(seen.normal), camera.rays()
            cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
            turned = np.sum(normal * np.asarray(self.smoothed(camera).normal), axis=-1)
            valid &= (cosine > GRAZING) & (turned > np.cos(BUMP))
        return valid


def open_reference(capture: Capture, name: str | None = None, *, progress: bool = True) -> Reference:
    """The accurate surface of a capture.

    Args:
        capture: whose surface.
        name: `true` (built-in room), `laser` (the venue's laser scans), `fused` (from the depth maps, at 2 cm) or a
            mesh file, which is taken as it is. By default the first of these that the capture has.

    Raises:
        InputError: the capture does not have it, or it cannot be read.
    """
    laser = capture.laser_folder
    if name is None:
        name = "true" if capture.reference() is not None else "laser" if laser is not None else "fused"
    if name not in WORDS and not Path(name).is_file():
        hint = did_you_mean(name, WORDS)
        raise InputError(f"reference: {name}: no such file{hint}; give a mesh file, or one of {', '.join(WORDS)}")
    if name == "laser":
        if laser is None:
            raise InputError(f"{capture.name}: has no laser scans; take 'fused' or a mesh file as the reference")
        discs = load_laser_scans(laser, LASER_VOXEL, progress)
        points = f"laser scans, {len(discs.vertices) // 4} points"
        return Reference(points, discs, RayCaster(discs).gbuffer, unread=False)
    fusion = FusionSettings(voxel=VOXEL, fuse_frames=0)
    description, mesh = surface_of(capture, name, fusion=fusion, progress=progress)
    if name != "fused":
        return Reference(description, mesh, RayCaster(mesh).gbuffer, measured=name != "true")
    return cleaned(description, mesh)


def cleaned(
    description: str, mesh: trimesh.Trimesh, relaxing: int = RELAXING, smoothing: int = SMOOTHING
) -> Reference:
    """A fusion as a reference, see above; `relaxing` passes over its vertices and `smoothing` over its normals."""
    mesh = relax(mesh, relaxing)
    clean, smoother = with_normals(mesh, smoothing), with_normals(mesh, BUMP_PASSES)
    return Reference(f"{description}, cleaned", clean, RayCaster(clean).gbuffer, RayCaster(smoother).gbuffer)
