"""Occluders: the mesh that casts a scan's shadows, with more detail than the lit mesh.

Legs of chairs and rims of tables are lost in a headset's coarse triangles, and holes let light through that the
room keeps out. Shadows may be thrown by anything that is known: here also by a finer fusion of the same depth maps,
where there are any, and with small holes closed. What it throws on itself for being only so accurate is forgiven
(`slack` of a `Scene`).
"""

import logging
from typing import TYPE_CHECKING

import numpy as np

from hyjax.data.capture import Capture
from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.scene.fusion_settings import FusionSettings
from hyjax.scene.surfaces import kept
from hyjax.util.cache import Arrays, cache_folder, cached_arrays
from hyjax.util.errors import InputError
from hyjax.util.files import digest

if TYPE_CHECKING:
    import trimesh

VERSION = 1
"""Version of the completion. Add one when its meshes change."""
LONGEST_GAP = 0.5
"""Longest edge that closes a hole, in metres."""
VOXEL = 0.03
"""Voxel of the finer fusion, in metres."""
_log = logging.getLogger(__name__)


def complete(mesh: "trimesh.Trimesh", detail: "trimesh.Trimesh | MeshArrays | None" = None) -> "trimesh.Trimesh":
    """Occluders of a scan: its surface with small holes closed, and a finer surface of the same place."""
    import trimesh

    from hyjax.geometry.hole_closing import close_holes

    closed = close_holes(mesh, LONGEST_GAP)
    if detail is None:
        return closed
    parts = [trimesh.Trimesh(part.vertices, part.faces, process=False) for part in (closed, detail)]
    return trimesh.util.concatenate(parts)  # type: ignore[return-value]


def completed(mesh: MeshArrays, detail: MeshArrays | None = None) -> MeshArrays:
    """Occluders by `complete`, kept in the cache folder under a key of its arguments."""

    def make() -> Arrays:
        whole = complete(mesh.mesh, detail)
        return {"vertices": np.asarray(whole.vertices), "faces": np.asarray(whole.faces, np.int32)}

    key = digest([str(VERSION), str(LONGEST_GAP), mesh.key, "" if detail is None else detail.key])
    return cached_arrays(cache_folder() / f"occluders-{key}.npz", MeshArrays.stored, make)


def fine_detail(capture: Capture, source: str | None, seed: int = 0, progress: bool = True) -> MeshArrays | None:
    """Finer surface of a place from its mesh's depth maps; None where there are none.

    Args:
        source: its mesh, as `surface_of` takes it. That of a file, or a fusion, has all the detail that there is.
        seed: of a simulated scan, whose depth maps are taken again, errors and all.
    """
    if source is None:
        source = "scan" if capture.has_reference else "captured"
    coarse = source == "scan" or (source == "captured" and capture.has_mesh)
    if not (coarse and capture.depth_count):
        return None
    try:
        if source == "scan":
            return kept(f"detail of scan {seed}, {VOXEL:g} m", capture, lambda: _of_scan(capture, seed, progress))
        from hyjax.scene.fusion import fuse_capture, plan_fusion  # slow to load

        plan = plan_fusion(capture, FusionSettings(voxel=VOXEL))
        return kept(repr(plan), capture, lambda: fuse_capture(capture, plan, progress=progress))
    except InputError as error:
        _log.warning("shadows are thrown by the mesh alone: %s", error)
        return None


def _of_scan(capture: Capture, seed: int, progress: bool) -> "trimesh.Trimesh":
    from hyjax.geometry.scan import ScanConfig, simulate_sensors
    from hyjax.geometry.tsdf import fuse

    frames, given = capture.scan_input()
    config = given or ScanConfig()
    views = simulate_sensors(frames, config, seed)
    return fuse(views, VOXEL, 3 * VOXEL, config.max_depth, config.min_weight, progress)
