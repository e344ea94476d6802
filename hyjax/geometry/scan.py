"""Simulated headset scan of a room: few coarse noisy depth maps, large voxels, few triangles.

The depth is measured (a capture's) or rendered from a true mesh (`RenderedDepths`). Errors of depth cameras
are added: noise along the axis that grows with z², pixels that look beside their place, steps between the
values, no reading on dark or grazing surfaces and at borders.

Sources: Nguyen, Izadi & Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking",
3DIMPVT 2012 (axial and lateral noise, z² law, grazing angles); Handa et al., "A benchmark for RGB-D visual
odometry, 3D reconstruction and SLAM", ICRA 2014 (jitter, steps).
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial.transform import Rotation

from hyjax.geometry.camera import Camera
from hyjax.geometry.depth_map import PosedDepth, clean_depth, posed_depths, view_cosine
from hyjax.geometry.mesh import degenerate_faces, submesh
from hyjax.geometry.raycast import RayCaster
from hyjax.geometry.surface import relax, with_normals
from hyjax.geometry.tsdf import fuse
from hyjax.util.errors import InputError


@dataclasses.dataclass(frozen=True)
class ScanConfig:
    """Errors and resolution of the simulated scanner. Lengths in metres, probabilities in [0, 1].

    Attributes:
        frames: how many depth maps it takes, spread evenly over those offered.
        width: columns of its depth map; rows follow from the picture's shape.
        max_depth: nothing is read beyond.
        noise: standard deviation along the axis at 1 m; grows with z².
        noise_grain: pixels over which that noise is correlated, as the sensor's own filter leaves it.
        jitter: standard deviation of where a pixel really looks, in pixels.
        step: spacing of depth values at 1 m; grows with z², as disparity's does.
        border_dropout: probability of losing a pixel beside a depth jump.
        grazing_cosine: surfaces at a smaller cosine to the ray are lost ever more surely.
        dark: display-encoded brightness under which half the pixels are lost (frames with a picture only).
        drift, turn: error of a frame's position, and of its orientation in radians, standard deviations.
        voxel, truncation: of the fusion.
        min_weight: least weight of a voxel, as in `fuse`.
        rounding: passes of smoothing over the vertices.
        edge: mean edge of the triangles after decimation.
        missing: share of the surface that is torn out in patches.
        hole: typical radius of such a patch.
    """

    frames: int = 60
    width: int = 128
    max_depth: float = 4.0
    noise: float = 0.006
    noise_grain: float = 1.5
    jitter: float = 0.4
    step: float = 0.003
    border_dropout: float = 0.3
    grazing_cosine: float = 0.15
    dark: float = 0.06
    drift: float = 0.008
    turn: float = 0.003
    voxel: float = 0.06
    truncation: float = 0.18
    min_weight: float = 0.05
    rounding: int = 1
    edge: float = 0.08
    missing: float = 0.04
    hole: float = 0.2

    def __post_init__(self) -> None:
        for name in ("frames", "width", "max_depth", "voxel", "truncation", "edge", "hole"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"scan: {name} is {getattr(self, name)}, must be > 0")
        for name in ("noise", "noise_grain", "jitter", "step", "dark", "drift", "turn", "min_weight", "rounding"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"scan: {name} is {getattr(self, name)}, must be >= 0")
        for name in ("border_dropout", "grazing_cosine", "missing"):
            if not 0 <= getattr(self, name) < 1:
                raise InputError(f"scan: {name} is {getattr(self, name)}, must lie in [0, 1)")


class PosedDepths(Protocol):
    """A capture, a list, or `RenderedDepths`: frames that are made when asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> PosedDepth: ...


class RenderedDepths:
    """Depth maps of a true mesh, each rendered when first asked for, and kept."""

    def __init__(self, mesh: trimesh.Trimesh, cameras: Sequence[Camera]) -> None:
        self._caster, self._cameras = RayCaster(mesh), cameras
        self._rendered: dict[int, Float[np.ndarray, "h w"]] = {}

    def __len__(self) -> int:
        return len(self._cameras)

    def __getitem__(self, index: int) -> tuple[Float[np.ndarray, "h w"], Camera]:
        camera = self._cameras[index]
        if index not in self._rendered:
            self._rendered[index] = np.asarray(self._caster.gbuffer(camera).depth)
        return self._rendered[index], camera


def simulate_scan(
    frames: PosedDepths, config: ScanConfig | None = None, seed: int = 0, progress: bool = True
) -> trimesh.Trimesh:
    """Mesh that a headset might make of a place from the depth in `frames`. The same seed gives the same mesh.

    Args:
        frames: a capture with depth, pairs (depth, camera), or `RenderedDepths(mesh, cameras)`.
    """
    config = config or ScanConfig()
    views = simulate_sensors(frames, config, seed)
    mesh = fuse(views, config.voxel, config.truncation, config.max_depth, config.min_weight, progress)
    return coarsen(mesh, config, np.random.default_rng((seed, len(frames))))


def simulate_sensors(
    frames: PosedDepths, config: ScanConfig, seed: int
) -> Iterator[tuple[Float[np.ndarray, "h w"], Camera]]:
    """The depth maps that `simulate_scan` makes its mesh of."""
    if len(frames) == 0:
        raise InputError("scan: no frames given; need at least one with depth")
    chosen = np.unique(np.linspace(0, len(frames) - 1, config.frames).round().astype(int))
    # A generator a frame, so that a frame's errors do not hang on how many came before it.
    return (simulate_sensor(frames[i], config, np.random.default_rng((seed, i))) for i in chosen.tolist())


def simulate_sensor(
    frame: PosedDepth, config: ScanConfig, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "h w"], Camera]:
    """One depth map as the simulated sensor reads it, with the pose that the headset estimates."""
    depth, camera, _ = next(posed_depths([frame]))
    k = camera.intrinsics
    width = min(config.width, k.width)
    small = k.resize(max(1, round(k.height * width / k.width)), width)
    # Where each small pixel looks, as a share of the picture.
    jitter = rng.normal(0.0, config.jitter, (2, *small.shape))
    v = (np.arange(small.height)[:, None] + 0.5 + jitter[0]) / small.height
    u = (np.arange(small.width)[None, :] + 0.5 + jitter[1]) / small.width
    reading = _sample(np.asarray(depth, dtype=np.float64), v, u)
    reading = np.where(np.isfinite(reading) & (reading < config.max_depth), reading, 0.0)
    lost = _lost(reading, Camera(small, camera.pose), config, rng)
    image = getattr(frame, "image", None)
    if image is not None:
        unlit = _sample(np.asarray(image).mean(axis=2), v, u) < config.dark
        lost |= unlit & (rng.random(small.shape) < 0.5)
    grain = ndimage.gaussian_filter(rng.standard_normal(small.shape), config.noise_grain)
    noisy = reading + config.noise * reading**2 * grain / grain.std()
    noisy = np.where((reading > 0) & ~lost, np.maximum(noisy, 0.0), 0.0)
    return _quantise(noisy, config.step).astype(np.float32), Camera(small, _perturb_pose(camera.pose, config, rng))


def _sample(
    values: Float[np.ndarray, "h w"], v: Float[np.ndarray, "r c"], u: Float[np.ndarray, "r c"]
) -> Float[np.ndarray, "r c"]:
    """Nearest pixel at positions given as shares of the height and width. Mixing depths would invent surfaces."""
    height, width = values.shape
    return values[np.clip(v * height, 0, height - 1).astype(int), np.clip(u * width, 0, width - 1).astype(int)]


def _lost(
    reading: Float[np.ndarray, "h w"], camera: Camera, config: ScanConfig, rng: np.random.Generator
) -> Bool[np.ndarray, "h w"]:
    """Pixels without a reading: surely at grazing angles, by chance near depth jumps."""
    cosine = view_cosine(reading, camera, reach=1)
    grazing = rng.random(reading.shape) > cosine / max(config.grazing_cosine, 1e-6)
    jump = (reading > 0) & (clean_depth(reading, camera, config.max_depth) == 0)
    # `fuse` drops the jump's own pixels; what the sensor loses is a ring around them.
    border = ndimage.binary_dilation(jump) & (rng.random(reading.shape) < config.border_dropout)
    return grazing | border


def _quantise(depth: Float[np.ndarray, "h w"], step: float) -> Float[np.ndarray, "h w"]:
    """Round disparity (1/depth) to multiples of `step` per metre, which spaces depths by step·z²."""
    if step == 0:
        return depth
    disparity = np.round(1.0 / np.maximum(depth, 1e-3) / step) * step
    return np.where(depth > 0, 1.0 / np.maximum(disparity, step), 0.0)


def _perturb_pose(
    pose: Float[np.ndarray, "4 4"], config: ScanConfig, rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """The pose with a tracker's error on it."""
    estimated = pose.copy()
    estimated[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(rng.normal(0.0, config.turn, 3)).as_matrix()
    estimated[:3, 3] += rng.normal(0.0, config.drift, 3)
    return estimated


def coarsen(mesh: trimesh.Trimesh, config: ScanConfig, rng: np.random.Generator) -> trimesh.Trimesh:
    """Round a mesh off, decimate it to edges of about `config.edge` and tear holes into it."""
    mesh = relax(mesh, config.rounding)
    target = int(mesh.area / (np.sqrt(3.0) / 4.0 * config.edge**2))  # equilateral triangles
    if target < len(mesh.faces):
        mesh = mesh.simplify_quadric_decimation(face_count=max(target, 4))
    vertices = np.asarray(mesh.vertices).astype(np.float32)  # as files hold them
    mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    bad = degenerate_faces(vertices, np.asarray(mesh.faces))
    bad |= _holes(mesh, config, rng)
    if bad.all():
        raise InputError("scan: nothing is left of the surface; take more frames or tear out less")
    return with_normals(submesh(mesh, ~bad), 1)


def _holes(mesh: trimesh.Trimesh, config: ScanConfig, rng: np.random.Generator) -> Bool[np.ndarray, "m"]:
    """Oblong patches that together make up about `config.missing` of the surface."""
    area, centre = np.asarray(mesh.area_faces), np.asarray(mesh.triangles_center)
    torn = np.zeros(len(area), dtype=bool)
    for start in rng.choice(len(area), size=len(area), replace=False, p=area / area.sum()):
        if area[torn].sum() >= config.missing * area.sum():
            break
        radii = config.hole * rng.uniform(0.4, 1.6, 3)
        torn |= np.linalg.norm((centre - centre[start]) / radii, axis=1) < 1.0
    return torn
