"""Surface of a capture: a file, the device's own mesh, a fusion, a simulated scan or the true one."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hyjax.data.capture import Capture
from hyjax.data.frames import spread
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.util.cache import cache_folder, cached_arrays
from hyjax.util.errors import InputError, did_you_mean
from hyjax.util.files import digest

if TYPE_CHECKING:
    import trimesh

    from hyjax.geometry.coverage import Coverage

VERSION = 4
"""Version of the surfaces. Add one when a fusion or a scan changes."""
ENOUGH_COVERAGE = 0.9
"""Coverage of a device's mesh from which no fusion is tried."""
LEAST_GAIN = 0.03
"""Least gain of coverage of a fusion over the device's mesh."""
SURFACE_ERROR, LARGEST_ERROR = 0.03, 0.1
"""Least and largest slack of shadows (`hyjax.light.shadow_map.ShadowMap`) of a mesh that is not exact; metres."""
READINGS_OFF = 3.0
"""Slack by the median distance between mesh and readings that it covers: of normal errors 96 % are smaller."""
WINDING_CAMERAS = 12
"""Number of cameras that tell the front of a mesh from its back."""
SENSOR_DEFAULTS = FusionSettings()
_log = logging.getLogger(__name__)
MESH_NAMES = ("captured", "scan", "fused", "true")
Surface = tuple[str, MeshArrays, float | None]
"""Name of a mesh, the mesh, and the slack of its shadows; None for an exact one."""


def surface_of(
    capture: Capture,
    mesh: str | None = None,
    *,
    fusion: FusionSettings = SENSOR_DEFAULTS,
    seed: int = 0,
    repair: bool = False,
    progress: bool = True,
) -> "tuple[str, trimesh.Trimesh]":
    """Mesh to relight a capture with. Meshes made here are kept in the cache folder.

    Warnings follow if it covers little of the measured depth, or lies elsewhere.

    Args:
        mesh: a file, or `"captured"` (that came with the capture), `"fused"` (from the depth maps), `"scan"` (a
            simulated headset scan, rough and with holes, drawn from `seed`), `"true"` (the built-in room's
            own). By default the built-in room gets its scan, and any other capture its own mesh, or else its
            fusion; its fusion, too, where that has clearly more of the measured depth.
        repair: drop unusable triangles of a mesh file instead of refusing it.

    Returns:
        Name of the chosen mesh, in a few words, and the mesh.
    """
    source, arrays, _ = surface_arrays(capture, mesh, fusion=fusion, seed=seed, repair=repair, progress=progress)
    return source, arrays.mesh


def surface_arrays(
    capture: Capture,
    mesh: str | None = None,
    *,
    fusion: FusionSettings = SENSOR_DEFAULTS,
    seed: int = 0,
    repair: bool = False,
    progress: bool = True,
    tracked: Capture | None = None,
) -> Surface:
    """Surface as arrays, so that one from the cache is there at once.

    Args: see `surface_of`; `tracked` is the capture with the device's own poses, with which its mesh was made.

    Returns:
        Name of the chosen mesh, in a few words, the mesh, and the slack of its shadows (see `Scene`).
    """
    check_surface(fusion, seed)
    if mesh is None and capture.has_reference:
        mesh = "scan"
    if mesh is None and capture.has_mesh:
        return _captured_or_fused(capture, tracked or capture, fusion, progress)
    if mesh == "captured":
        if not capture.has_mesh:
            raise InputError(
                f"{capture.name}: no mesh came with this capture (of an ARKitScenes scan, download asset 'mesh'); "
                "use 'fused', 'scan' or a file"
            )
        return _judged(capture, *_captured(capture))
    if mesh in (None, "fused"):
        return _judged(capture, *_fused(capture, fusion, progress))
    if mesh not in MESH_NAMES:
        check_mesh_name(mesh)
        from hyjax.geometry.mesh import load_mesh

        return _judged(capture, mesh, _facing(_in_metres(load_mesh(Path(mesh), repair), mesh), mesh, capture))
    if mesh == "true":
        true = capture.reference()
        if true is None:
            raise InputError("mesh: this capture has no true mesh; use 'fused', 'scan' or a file")
        return "true mesh", MeshArrays.of(true), None
    if not capture.depth_count:
        raise InputError(f"{capture.name}: the capture has no depth to make a mesh of; give one with --mesh FILE")
    description = f"simulated scan, seed {seed}"

    def make() -> "trimesh.Trimesh":
        from hyjax.geometry.scan import simulate_scan

        return simulate_scan(*capture.scan_input(), seed, progress)

    return description, kept(description, capture, make), SURFACE_ERROR


def will_fuse(capture: Capture, mesh: str | None, fusion: FusionSettings) -> bool:
    """Whether `surface_of` would fuse depth maps, or would compare their fusion with the device's mesh."""
    if not capture.depth_count or (mesh is None and capture.has_reference):
        return False
    if mesh is not None or not capture.has_mesh:
        return mesh in (None, "fused")
    try:
        return _coverage(capture, _captured(capture, facing=False)[1], fusion).covered < ENOUGH_COVERAGE
    except InputError:
        return True


def _coverage(capture: Capture, mesh: MeshArrays, fusion: FusionSettings = SENSOR_DEFAULTS) -> "Coverage":
    from hyjax.scene.fusion import coverage_of  # slow to load

    return coverage_of(capture, mesh, fusion.confidence)


def _captured(capture: Capture, *, facing: bool = True) -> tuple[str, MeshArrays]:
    mesh, file = capture.mesh(), capture.mesh_file
    assert mesh is not None
    description = "captured mesh" if file is None else f"captured mesh {file.name}"
    where = str(file or capture.name)
    arrays = _in_metres(mesh, where)
    return description, _facing(arrays, where, capture) if facing else arrays


def _fused(capture: Capture, fusion: FusionSettings, progress: bool) -> tuple[str, MeshArrays]:
    from hyjax.scene.fusion import fuse_capture, plan_fusion  # slow to load

    plan = plan_fusion(capture, fusion)

    def make() -> "trimesh.Trimesh":
        checkpoint = cache_folder() / f"fusion-{digest([str(VERSION), capture.fingerprint, repr(plan)])}.npz"
        return fuse_capture(capture, plan, checkpoint=checkpoint, progress=progress)

    return str(plan), kept(repr(plan), capture, make)


def _captured_or_fused(capture: Capture, tracked: Capture, fusion: FusionSettings, progress: bool) -> Surface:
    """Mesh of the device, or the fusion of its depth where that has clearly more of the measured depth."""
    from hyjax.scene.fusion import tell_coverage

    if not capture.depth_count:
        return *_captured(capture), SURFACE_ERROR
    try:
        chosen = _captured(capture)
    except InputError as error:
        if capture.strict:
            raise InputError(f"{error} (--strict)") from None
        _log.warning("%s; its depth maps are fused instead", error)
        return _judged(capture, *_fused(capture, fusion, progress))
    coverage = _coverage(tracked, chosen[1], fusion)
    if coverage.measured and coverage.covered < ENOUGH_COVERAGE:
        try:
            fused = _fused(capture, fusion, progress)
        except InputError as error:
            _log.warning("%s; taking the %s", error, chosen[0])
            return *chosen, _slack(coverage)
        fused_coverage = _coverage(capture, fused[1], fusion)
        if fused_coverage.covered > coverage.covered + LEAST_GAIN:
            _log.warning(
                "%s: the %s agrees with %.0f %% of the depth readings, the fusion of its depth with %.0f %%: that "
                "is taken (--mesh captured for the other)",
                capture.name,
                chosen[0],
                100 * coverage.covered,
                100 * fused_coverage.covered,
            )
            chosen, coverage = fused, fused_coverage
    tell_coverage(capture, chosen[0], coverage)
    return *chosen, _slack(coverage)


def _judged(capture: Capture, description: str, mesh: MeshArrays) -> Surface:
    if not capture.depth_count:
        return description, mesh, SURFACE_ERROR
    from hyjax.scene.fusion import tell_coverage

    coverage = _coverage(capture, mesh)
    tell_coverage(capture, description, coverage)
    return description, mesh, _slack(coverage)


def _slack(coverage: "Coverage") -> float:
    return float(np.clip(READINGS_OFF * np.nan_to_num(coverage.error), SURFACE_ERROR, LARGEST_ERROR))


def kept(description: str, capture: Capture, make: "Callable[[], trimesh.Trimesh]") -> MeshArrays:
    """Mesh from the cache folder, or made and kept there, under its description and the capture."""
    file = cache_folder() / f"surface-{digest([f'{VERSION} {description} {capture.fingerprint}'])}.npz"
    return cached_arrays(file, MeshArrays.stored, lambda: MeshArrays.of(make()).to_store())


def _in_metres(mesh: "trimesh.Trimesh", where: str) -> MeshArrays:
    if not 0.1 < max(mesh.extents) < 1000:
        raise InputError(f"{where}: spans {max(mesh.extents):.3g} m; a room's mesh must be in metres")
    return MeshArrays.of(mesh)


def _facing(mesh: MeshArrays, where: str, capture: Capture) -> MeshArrays:
    """Mesh of somebody else with its front to the cameras."""
    from hyjax.geometry.raycast import RayCaster
    from hyjax.geometry.winding import turned, turned_away

    cameras = [capture.camera(index) for index in spread(range(len(capture)), WINDING_CAMERAS)]
    away = turned_away(RayCaster(mesh), cameras)
    if not away.any():
        return mesh
    said = "%s: parts of it show the cameras their back, %.3g %% of the triangles; they are turned"
    _log.warning(said, where, 100 * away.mean())
    return turned(mesh, away)


def check_surface(fusion: FusionSettings, seed: int) -> None:
    """Raise `InputError` for invalid settings of a surface or a negative seed."""
    fusion.check()
    if seed < 0:
        raise InputError(f"seed: must be >= 0, got {seed}")


def rough_mesh(capture: Capture) -> str:
    """Name of a headset's mesh of a capture: its own, or else a simulated scan."""
    return "captured" if capture.has_mesh else "scan"


def check_mesh_name(mesh: str | None) -> None:
    """Raise `InputError` unless `mesh` is one of `MESH_NAMES` or an existing file."""
    if mesh is not None and mesh not in MESH_NAMES and not Path(mesh).is_file():
        hint = did_you_mean(mesh, MESH_NAMES)
        names = ", ".join(MESH_NAMES)
        raise InputError(f"{mesh}: no such file{hint}; give a PLY, OBJ or GLB file, or one of {names}")
